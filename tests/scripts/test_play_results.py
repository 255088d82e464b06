"""What is older than the code is listed, and measured again in turn."""

import json
from pathlib import Path

import pytest

from scripts import play_results
from scripts.__main__ import COMMANDS
from scripts.play_results import stale


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Results of one page and one section, in a repository in which only `old` is old."""
    page = {"revision": "old", "date": "2026-01-01", "figures": {}}
    (tmp_path / "real.json").write_text(json.dumps(page))
    sections = {"soak": {"revision": "new", "date": "2026-01-02"}}
    (tmp_path / "reliability.json").write_text(json.dumps({**page, "figures": sections}))

    def git(*arguments: str) -> str:
        return "3" if "old..HEAD" in arguments else "0" if "new..HEAD" in arguments else ""

    monkeypatch.setattr(play_results, "RESULTS", tmp_path)
    monkeypatch.setattr(play_results, "_git", git)
    return tmp_path


@pytest.mark.usefixtures("results")
def test_a_page_older_than_the_code_is_stale() -> None:
    assert stale("real") == "measured at old (2026-01-01), 3 commits of app, index, descriptor ago"
    assert stale("soak") is None
    assert stale("cameras") == stale("people") == "never measured"


def test_what_was_measured_stays_when_the_command_goes_on(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = []

    def measure(command: list[str], **_: object) -> None:
        played.append(command[3:])
        if command[-1] == "real":
            page = {"revision": "new", "date": "2026-01-02", "figures": {}}
            (results / "real.json").write_text(json.dumps(page))

    monkeypatch.setattr(play_results.subprocess, "run", measure)
    assert play_results.main([]) == 1
    assert ["evaluate", "real"] in played and ["soak", "--write"] not in played
    first = len(played)
    assert play_results.main([]) == 1
    assert ["evaluate", "real"] not in played[first:]


def test_every_page_has_a_command() -> None:
    assert {command[0] for command in play_results.COMMANDS.values()} <= set(COMMANDS)
