"""The manifests are valid, agree with one another, and speak of the service as it is."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from app.__main__ import SHUTDOWN_GRACE_S
from app.main import create_app
from app.settings import VARIABLES, Settings
from scripts.figures import measured
from tests.conftest import ROOT
from tests.support.programs import output_of

DEPLOY = ROOT / "deploy"
BALANCER = (DEPLOY / "haproxy.cfg").read_text()
# The oldest that is still supported somewhere, and the newest that the validator knows.
VERSIONS = ("1.31", kubernetes_validate.latest_version())
Document = dict[str, Any]


def documents(*files: Path) -> list[Document]:
    return [doc for file in files for doc in yaml.safe_load_all(file.read_text())]


KUSTOMIZATION = yaml.safe_load((DEPLOY / "kustomization.yaml").read_text())
MANIFESTS = documents(*(DEPLOY / name for name in KUSTOMIZATION["resources"]))
CLAIM = documents(DEPLOY / "kubernetes" / "index-volume" / "claim.yaml")
PODS = [doc for doc in MANIFESTS if doc["kind"] == "Deployment"]


def title(document: Document) -> str:
    return f"{document['kind']}-{document['metadata']['name']}"


def the(kind: str, name: str) -> Document:
    (found,) = (doc for doc in MANIFESTS if title(doc) == f"{kind}-{name}")
    return found


def walk(node: Any, key: str) -> Iterator[Any]:
    """Everything that stands under a key, at any depth."""
    if isinstance(node, dict):
        for name, value in node.items():
            if name == key:
                yield value
            yield from walk(value, key)
    elif isinstance(node, list):
        for value in node:
            yield from walk(value, key)


def pod(deployment: Document) -> Document:
    return deployment["spec"]["template"]["spec"]


def container(deployment: Document) -> Document:
    (only,) = pod(deployment)["containers"]
    return only


def port_names(deployment: Document) -> dict[str, int]:
    return {port["name"]: port["containerPort"] for port in container(deployment)["ports"]}


def chosen(labels: Document) -> Document:
    """The one deployment whose pods have these labels."""
    (found,) = (
        doc
        for doc in PODS
        if labels.items() <= doc["spec"]["template"]["metadata"]["labels"].items()
    )
    return found


def mebibytes(quantity: str) -> int:
    number, unit = re.fullmatch(r"(\d+)(Mi|Gi)", quantity).groups()  # type: ignore[union-attr]
    return int(number) * {"Mi": 1, "Gi": 1024}[unit]


REPLICAS, HAPROXY = the("Deployment", "pose"), the("Deployment", "pose-balancer")
VALUES = {each["name"]: each.get("value") for each in container(REPLICAS)["env"]}


class TestSchema:
    @pytest.mark.parametrize("version", VERSIONS)
    @pytest.mark.parametrize("document", MANIFESTS + CLAIM, ids=title)
    def test_every_document_is_valid(self, document: Document, version: str) -> None:
        kubernetes_validate.validate(document, version, strict=True)

    def test_every_manifest_is_applied(self) -> None:
        listed = {(DEPLOY / name).resolve() for name in KUSTOMIZATION["resources"]}
        assert listed == set((DEPLOY / "kubernetes").glob("*.yaml"))


class TestKustomize:
    @staticmethod
    def built(folder: Path) -> list[Document]:
        if shutil.which("kubectl") is None:
            pytest.skip("needs kubectl")
        return list(yaml.safe_load_all(output_of("kubectl", "kustomize", folder)))

    def test_the_balancer_gets_the_one_configuration(self) -> None:
        built = self.built(DEPLOY)
        for document in built:
            kubernetes_validate.validate(document, VERSIONS[-1], strict=True)
        (configuration,) = (doc for doc in built if doc["kind"] == "ConfigMap")
        assert configuration["data"] == {"haproxy.cfg": BALANCER}
        (deployment,) = (doc for doc in built if title(doc) == "Deployment-pose-balancer")
        (volume,) = pod(deployment)["volumes"]
        assert volume["configMap"]["name"] == configuration["metadata"]["name"]

    def test_an_index_on_a_volume_replaces_the_one_in_the_image(self, tmp_path: Path) -> None:
        folder = tmp_path / "deploy"
        shutil.copytree(DEPLOY, folder)
        file = folder / "kustomization.yaml"
        text = file.read_text()
        file.write_text(
            text.replace("# components:", "components:").replace(
                "#   - kubernetes/", "  - kubernetes/"
            )
        )
        built = self.built(folder)
        for document in built:
            kubernetes_validate.validate(document, VERSIONS[-1], strict=True)
        (deployment,) = (doc for doc in built if title(doc) == "Deployment-pose")
        (volume,), (mount,) = pod(deployment)["volumes"], container(deployment)["volumeMounts"]
        assert volume["persistentVolumeClaim"]["readOnly"] is mount["readOnly"] is True
        index = next(v for v in container(deployment)["env"] if v["name"] == "POSE_INDEX")
        assert index["value"] == mount["mountPath"]
        # The other settings are still there.
        assert len(container(deployment)["env"]) == len(container(REPLICAS)["env"]) + 1
        (claim,) = (doc for doc in built if doc["kind"] == "PersistentVolumeClaim")
        assert claim["metadata"]["name"] == volume["persistentVolumeClaim"]["claimName"]


class TestReferences:
    @pytest.mark.parametrize("deployment", PODS, ids=title)
    def test_selectors_match_labels(self, deployment: Document) -> None:
        labels = deployment["spec"]["template"]["metadata"]["labels"]
        assert deployment["spec"]["selector"]["matchLabels"] == labels
        for spread in pod(deployment)["topologySpreadConstraints"]:
            assert spread["labelSelector"]["matchLabels"] == labels

    @pytest.mark.parametrize(
        ("service", "deployment"), [("pose", HAPROXY), ("pose-replicas", REPLICAS)]
    )
    def test_services_lead_to_pods(self, service: str, deployment: Document) -> None:
        spec = the("Service", service)["spec"]
        assert chosen(spec["selector"]) is deployment
        assert all(port["targetPort"] in port_names(deployment) for port in spec["ports"])

    def test_the_autoscaler_has_an_existing_target(self) -> None:
        spec = the("HorizontalPodAutoscaler", "pose")["spec"]
        target = spec["scaleTargetRef"]
        assert f"{target['kind']}-{target['name']}" == title(REPLICAS)
        # Else every `kubectl apply` would undo what it has done.
        assert "replicas" not in REPLICAS["spec"]
        places = {int(places) for places in re.findall(r"server-template pose- 1-(\d+)", BALANCER)}
        assert 2 <= spec["minReplicas"] < spec["maxReplicas"] <= min(places)
        assert "cpu" in container(REPLICAS)["resources"]["requests"]


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

    def test_settings_are_settings(self) -> None:
        ours = {name for name in VALUES if name.startswith("POSE_")}
        assert ours
        assert ours <= set(VARIABLES)
        named = set(re.findall(r"\bPOSE_[A-Z_]+\b", BALANCER + (DEPLOY / "README.md").read_text()))
        assert named <= set(VARIABLES)

    def test_concurrency_equals_the_cores(self) -> None:
        assert VALUES["POSE_CONCURRENCY"] == container(REPLICAS)["resources"]["limits"]["cpu"]

    def test_the_memory_limit_fits_the_settings(self) -> None:
        peak = measured("reliability")["fuzz"]["max_memory_mb"]
        defaults = {name: field.default for name, field in Settings.model_fields.items()}
        uploads = defaults["max_requests"] * defaults["max_upload_bytes"] // 1024**2
        cameras = int(VALUES["POSE_CAMERA_MEMORY_MB"] or 0)
        limit = mebibytes(container(REPLICAS)["resources"]["limits"]["memory"])
        assert peak + uploads + cameras <= limit

    @pytest.mark.parametrize("deployment", PODS, ids=title)
    def test_the_grace_period_covers_the_shutdown(self, deployment: Document) -> None:
        (before,) = (
            int(command[1])
            for command in walk(container(deployment)["lifecycle"], "command")
            if command[0] == "sleep"
        )
        assert pod(deployment)["terminationGracePeriodSeconds"] > before + SHUTDOWN_GRACE_S

    def test_the_user_matches_the_image(self) -> None:
        user = re.search(r"^USER (\d+):(\d+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
        assert user is not None
        security = pod(REPLICAS)["securityContext"]
        assert (security["runAsUser"], security["runAsGroup"]) == tuple(map(int, user.groups()))

    def test_balancer_timeouts_outlast_service_timeouts(self) -> None:
        defaults = {name: field.default for name, field in Settings.model_fields.items()}

        def seconds(pattern: str) -> int:
            (found,) = re.findall(rf"^ *{pattern} (\d+)s\b", BALANCER, re.MULTILINE)
            return int(found)

        assert seconds("timeout server") > defaults["request_timeout_s"]
        assert seconds("http-request set-timeout server") > defaults["sequence_timeout_s"]
        assert seconds("timeout client") > max(
            defaults["upload_timeout_s"], defaults["video_upload_timeout_s"]
        )
        assert re.findall(r"default-server maxconn (\d+)", BALANCER) == [
            str(defaults["max_requests"])
        ]
