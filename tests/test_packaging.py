"""The files that others run the service with fit it, as far as can be told without them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from app.__main__ import GRACE_S
from tests.conftest import ROOT

DOCKERFILE = (ROOT / "Dockerfile").read_text()
UNIT = ROOT / "deploy" / "silhouette-pose.service"


def test_what_the_dockerfile_copies_is_there_and_not_ignored() -> None:
    allowed = {
        line.removeprefix("!")
        for line in (ROOT / ".dockerignore").read_text().splitlines()
        if line.startswith("!")
    }
    copied = re.findall(r"^COPY (?!--from)(\S+) ", DOCKERFILE, re.MULTILINE)
    assert copied
    for source in copied:
        assert (ROOT / source).exists(), source
        assert source in allowed, f"{source} does not reach the build: see .dockerignore"


def test_the_container_is_no_root_and_checks_its_health() -> None:
    final = DOCKERFILE.split("\nFROM ")[-1]
    assert re.search(r"^USER \d+:\d+$", final, re.MULTILINE)
    assert "HEALTHCHECK" in final
    assert "/readyz" in final
    compose = (ROOT / "compose.yaml").read_text()
    assert "read_only: true" in compose
    assert "cap_drop: [ALL]" in compose


@pytest.mark.parametrize(
    ("file", "pattern"),
    [("compose.yaml", r"stop_grace_period: (\d+)s"), (UNIT, r"TimeoutStopSec=(\d+)")],
)
def test_nobody_kills_it_while_it_finishes_what_runs(file: str | Path, pattern: str) -> None:
    found = re.search(pattern, (ROOT / file).read_text())
    assert found is not None
    assert int(found.group(1)) > GRACE_S


def test_the_unit_is_sound(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    unit = tmp_path / UNIT.name
    # It asks whether the program is there.
    text = UNIT.read_text().replace("/opt/silhouette-pose/.venv/bin/python", sys.executable)
    unit.write_text(text)
    result = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stderr) == (0, "")
