"""The alerts and the dashboard ask for metrics that ``/metrics`` has, by labels that they have."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from tests.conftest import ROOT, Photo
from tests.support.programs import output_of

ALERTS = ROOT / "deploy" / "alerts.yml"
CASES = Path(__file__).with_name("alerts_cases.yml")
DASHBOARD = json.loads((ROOT / "deploy" / "dashboard.json").read_text())
RULES: list[dict[str, Any]] = [
    rule for group in yaml.safe_load(ALERTS.read_text())["groups"] for rule in group["rules"]
]
PANELS: list[dict[str, Any]] = [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]
EXPRESSIONS = {
    **{rule["alert"]: [rule["expr"]] for rule in RULES},
    **{
        f"{panel['title']} ({panel['type']})": [target["expr"] for target in panel["targets"]]
        for panel in PANELS
    },
    "variables": [variable["query"]["query"] for variable in DASHBOARD["templating"]["list"][1:]],
    "annotations": [annotation["expr"] for annotation in DASHBOARD["annotations"]["list"]],
}
OF_PROMETHEUS = {"job", "instance", "le"}
SUFFIXES = {"histogram": ("_bucket", "_sum", "_count"), "counter": ("_total",), "gauge": ("",)}

_METRIC = re.compile(r"\b((?:pose|process)_[a-z_]+)\b(?:\{([^}]*)\})?")
_LABEL = re.compile(r'(\w+)\s*(?:=~|!~|!=|=)\s*"([^"]*)"')


@pytest.fixture(scope="module")
def metrics(serving: Any, photo: Photo) -> dict[str, set[str]]:
    """The samples that a service may have, and of those that a few requests caused, the labels."""
    client: TestClient = serving(revision="test")
    client.post("/pose", files=photo.files)
    client.post("/pose", files={"frame": b"?"})
    client.post("/cameras/yard/frames", files=photo.files)
    client.post("/cameras/gate/frames", files=photo.files)
    client.post("/cameras/gate/frames", files={"frame": b"?"})
    client.post("/sequence", files={"video": b"?"})
    client.delete("/cameras/yard")
    labels: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for suffix in SUFFIXES.get(family.type, ()):
            labels.setdefault(family.name + suffix, set())
        for sample in family.samples:
            labels.setdefault(sample.name, set()).update(sample.labels)
    return labels


def selectors(expression: str) -> list[tuple[str, dict[str, str]]]:
    """The metrics of an expression, each with its label matchers."""
    return [(name, dict(_LABEL.findall(text))) for name, text in _METRIC.findall(expression)]


@pytest.mark.parametrize("title", EXPRESSIONS)
def test_every_metric_and_label_exists(title: str, metrics: dict[str, set[str]]) -> None:
    for expression in EXPRESSIONS[title]:
        found = selectors(expression)
        assert found or re.search(r"\bup\{", expression), expression
        for name, matchers in found:
            assert name in metrics, name
            assert set(matchers) <= metrics[name] | OF_PROMETHEUS, (name, matchers)


needs_promtool = pytest.mark.skipif(
    shutil.which("promtool") is None, reason="needs promtool: apt-get install prometheus"
)


@needs_promtool
def test_alerts_go_off_when_they_should_and_not_before(tmp_path: Path) -> None:
    # Cases say nothing of annotations, which promtool compares as well.
    bare = [{key: rule[key] for key in rule if key != "annotations"} for rule in RULES]
    rules = {"groups": [{"name": "pose", "rules": bare}]}
    (tmp_path / "alerts.yml").write_text(yaml.safe_dump(rules))
    shutil.copy(CASES, tmp_path)
    output_of("promtool", "test", "rules", tmp_path / CASES.name)
