"""``docs/operations.md`` says what the service does."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from app.http.logs import JsonFormatter
from app.settings import VARIABLES
from scripts.settings_table import OPERATIONS, section
from tests.conftest import ROOT

TEXT = OPERATIONS.read_text()


def part(title: str) -> str:
    """The text under a heading."""
    return TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]


def names(text: str) -> set[str]:
    """What stands in backticks."""
    return set(re.findall(r"`([^`]+)`", text))


def test_the_table_of_settings_is_not_stale() -> None:
    assert part("Settings").strip() == section(), "run python -m scripts.settings_table"


def test_every_metric_is_described_and_no_other(client: TestClient) -> None:
    families = text_string_to_metric_families(client.get("/metrics").text)
    # What counts is called _total by those who ask for it.
    served = {
        f"{family.name}_total" if family.type == "counter" else family.name
        for family in families
        if family.name.startswith("pose_") and not family.name.endswith("_created")
    }
    described = {name for name in names(part("Metrics")) if re.fullmatch(r"pose_\w+", name)}
    assert described == served


def test_every_reason_in_the_code_is_described() -> None:
    code = "".join(path.read_text() for path in Path(ROOT / "app").rglob("*.py"))
    reasons = set(re.findall(r'reason ?= ?"(\w+)"', code)) - {"busy"}
    reasons |= set(re.findall(r'overloaded\(\s*[^,]+,\s*"(\w+)"', code))
    assert reasons - names(part("Metrics")) == set()


def test_every_field_of_a_log_line_is_described(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.handler.setFormatter(JsonFormatter())
    with caplog.at_level(logging.INFO, logger="app"):
        client.post("/pose", files={"frame": b"?"})
    fields = set(json.loads(caplog.text.splitlines()[-1]))
    assert fields <= names(part("Logs"))


def test_nothing_is_said_of_settings_and_scripts_that_are_gone() -> None:
    unit = (ROOT / "deploy" / "silhouette-pose.service").read_text()
    for text in (TEXT, unit, (ROOT / "compose.yaml").read_text()):
        for script in re.findall(r"-m (scripts(?:\.\w+)+)", text):
            assert (ROOT / f"{script.replace('.', '/')}.py").is_file(), script
        for variable in set(re.findall(r"\bPOSE_[A-Z_]+\b", text)):
            assert variable in VARIABLES, variable
