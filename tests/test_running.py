"""``docs/running.md`` says what the service does."""

import json
import logging
import os
import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families
from pydantic.fields import FieldInfo

from app.http.access_log import JsonFormatter
from app.scheduling.job import STAGES
from app.settings import VARIABLES, Settings, variable
from scripts.__main__ import COMMANDS
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "running.md"

TEXT = PAGE.read_text()
CONNECTING = (ROOT / "docs" / "connecting.md").read_text()


def part(title: str) -> str:
    """The text under a heading."""
    return TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]


def names(text: str) -> set[str]:
    """What stands in backticks."""
    return set(re.findall(r"`([^`]+)`", text))


def settings_table() -> str:
    """All settings, as the page shows them."""
    rows = [
        f"| `{variable(name, field)}` | {default(field)} | {field.description or plain(name)} |"
        for name, field in Settings.model_fields.items()
    ]
    return "\n".join(["| variable | default | meaning |", "|---|---|---|", *rows])


def plain(name: str) -> str:
    return f"{name.replace('_', ' ').capitalize()}."


def default(field: FieldInfo) -> str:
    if field.default_factory is not None:
        return "cores, or the container's quota"
    value = field.default
    if isinstance(value, Path):
        return f"`{value.relative_to(ROOT)}` of the service"
    return "none" if value == () else f"`{value}`"


def test_the_stages_of_a_frame_are_listed() -> None:
    (row,) = re.findall(r"^\| `pose_stage_seconds` .*", part("Metrics"), re.MULTILINE)
    assert names(row) == {"pose_stage_seconds", "stage", "total", *STAGES}


def test_the_table_of_settings_is_not_stale() -> None:
    table = re.search(r"^\| variable .*(?:\n\|.*)+", part("Settings"), re.MULTILINE)
    assert table is not None
    if os.environ.get("REWRITE"):
        PAGE.write_text(TEXT.replace(table[0], settings_table()))
    else:
        assert table[0] == settings_table(), "run this test with REWRITE=1"


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


def test_every_field_of_a_log_line_is_described(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(caplog.handler, "formatter", JsonFormatter())
    with caplog.at_level(logging.INFO, logger="app"):
        client.post("/pose", files={"frame": b"?"})
    fields = set(json.loads(caplog.text.splitlines()[-1]))
    assert fields <= names(part("Logs"))


def test_nothing_is_said_of_settings_and_scripts_that_are_gone() -> None:
    unit = (ROOT / "deploy" / "silhouette-pose.service").read_text()
    for text in (TEXT, CONNECTING, unit, (ROOT / "compose.yaml").read_text()):
        for command in re.findall(r"-m scripts ([\w-]+)", text):
            assert command in COMMANDS, command
        assert "-m scripts." not in text
        for name in set(re.findall(r"\bPOSE_[A-Z_]+\b", text)):
            assert name in VARIABLES, name
