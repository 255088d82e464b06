"""The manifests are valid, and speak of the service as it is."""

import re
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from app.main import create_app
from app.settings import VARIABLES, Settings
from tests.conftest import ROOT

DEPLOY = ROOT / "deploy"
BALANCER = (DEPLOY / "haproxy.cfg").read_text()
Document = dict[str, Any]


def documents(*files: Path) -> list[Document]:
    return [doc for file in files for doc in yaml.safe_load_all(file.read_text())]


KUSTOMIZATION = yaml.safe_load((DEPLOY / "kustomization.yaml").read_text())
MANIFESTS = documents(*(DEPLOY / name for name in KUSTOMIZATION["resources"]))
CLAIM = documents(DEPLOY / "kubernetes" / "index-volume" / "claim.yaml")


def title(document: Document) -> str:
    return f"{document['kind']}-{document['metadata']['name']}"


def the(kind: str, name: str) -> Document:
    (found,) = (doc for doc in MANIFESTS if title(doc) == f"{kind}-{name}")
    return found


def pod(deployment: Document) -> Document:
    return deployment["spec"]["template"]["spec"]


def container(deployment: Document) -> Document:
    (only,) = pod(deployment)["containers"]
    return only


def port_names(deployment: Document) -> dict[str, int]:
    return {port["name"]: port["containerPort"] for port in container(deployment)["ports"]}


REPLICAS, HAPROXY = the("Deployment", "pose"), the("Deployment", "pose-balancer")
VALUES = {each["name"]: each.get("value") for each in container(REPLICAS)["env"]}


class TestSchema:
    @pytest.mark.parametrize("document", MANIFESTS + CLAIM, ids=title)
    def test_every_document_is_valid(self, document: Document) -> None:
        # The oldest version that is still supported somewhere.
        kubernetes_validate.validate(document, "1.31", strict=True)


class TestService:
    def test_probes_use_existing_routes(self) -> None:
        served = create_app(Settings()).openapi()["paths"]
        probes = [
            container(REPLICAS)[f"{kind}Probe"] for kind in ("startup", "liveness", "readiness")
        ]
        assert [probe["httpGet"]["path"] for probe in probes] == ["/healthz", "/healthz", "/readyz"]
        for probe in probes:
            assert probe["httpGet"]["path"] in served
            assert probe["httpGet"]["port"] in port_names(REPLICAS)
        for probe in (container(HAPROXY)[f"{kind}Probe"] for kind in ("liveness", "readiness")):
            assert probe["httpGet"]["path"] in BALANCER.split("frontend operations")[1]
            assert probe["httpGet"]["port"] in port_names(HAPROXY)

    def test_every_setting_that_is_named_exists(self) -> None:
        ours = {name for name in VALUES if name.startswith("POSE_")}
        assert ours
        assert ours <= set(VARIABLES)
        named = set(re.findall(r"\bPOSE_[A-Z_]+\b", BALANCER + (DEPLOY / "README.md").read_text()))
        assert named <= set(VARIABLES)
