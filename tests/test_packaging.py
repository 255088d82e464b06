"""The files that others run the service with fit it, as far as can be told without them."""

import re
import shlex
import shutil
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from app.__main__ import SHUTDOWN_GRACE_S
from app.bridge.settings import Settings as BridgeSettings
from app.settings import Settings
from tests.conftest import ROOT
from tests.support.programs import output_of, run

DOCKERFILE = (ROOT / "Dockerfile").read_text()
UNIT = ROOT / "deploy" / "silhouette-pose.service"
PEAK_MB = 536
"""Of a process under hostile uploads: docs/notes/history.md, `fuzz`."""

INSTALLED = "/opt/silhouette-pose/.venv/bin/python"


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


@pytest.mark.parametrize(
    ("file", "pattern"),
    [("compose.yaml", r"stop_grace_period: (\d+)s"), (UNIT, r"TimeoutStopSec=(\d+)")],
)
def test_nobody_kills_it_while_it_finishes_what_runs(file: str | Path, pattern: str) -> None:
    found = re.search(pattern, (ROOT / file).read_text())
    assert found is not None
    assert int(found.group(1)) > SHUTDOWN_GRACE_S


@pytest.mark.parametrize(
    ("file", "pattern"), [("compose.yaml", r"mem_limit: (\d+)m"), (UNIT, r"MemoryMax=(\d+)M")]
)
def test_the_uploads_that_are_taken_fit_the_memory_limit(file: str | Path, pattern: str) -> None:
    found = re.search(pattern, (ROOT / file).read_text())
    assert found is not None
    defaults = {name: field.default for name, field in Settings.model_fields.items()}
    uploads_mb = defaults["max_requests"] * defaults["max_upload_bytes"] / 1024**2
    assert PEAK_MB + uploads_mb <= int(found.group(1))


@pytest.mark.parametrize("name", ["silhouette-pose.service", "silhouette-watch.service"])
def test_a_unit_is_sound(name: str, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    # It asks whether the program is there.
    text = (ROOT / "deploy" / name).read_text().replace(INSTALLED, sys.executable)
    unit = tmp_path / name
    unit.write_text(text)
    result = run("systemd-analyze", "verify", unit)
    assert (result.returncode, result.stderr) == (0, "")
    assert "network-online.target" in text
    assert "RestartSec" in text


def test_the_unit_knows_its_revision() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("needs a checkout")
    (command,) = re.findall("^ExecStart=(.+)", UNIT.read_text(), re.MULTILINE)
    shell, option, program = shlex.split(command.replace("$$", "$"))
    environment = output_of(shell, option, program.replace(f"{INSTALLED} -m app", "env"))
    revision = output_of("git", "rev-parse", "--short", "HEAD")
    assert f"POSE_REVISION={revision}" in environment


@pytest.mark.parametrize("file", ["compose.yaml", "deploy/silhouette-watch.service"])
def test_the_bridge_is_run_as_it_expects(file: str) -> None:
    text = (ROOT / file).read_text()
    (command,) = re.findall(r"-m app.bridge (.+)", text)
    # The folder of its file is only there.
    ended = run(sys.executable, "-m", "app.bridge", *command.split())
    expected = f"silhouette-pose-watch: expected a file of cameras, got {command}: No such file"
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith(expected)
    assert {name.removeprefix("WATCH_").lower() for name in re.findall("WATCH_[A-Z]+", text)} < {
        *BridgeSettings.model_fields
    }


def test_what_was_tested_is_what_is_installed() -> None:
    text = (ROOT / "constraints.txt").read_text()
    held = {
        canonicalize_name(requirement.name): requirement
        for requirement in map(Requirement, re.findall(r"^[^#\n]+", text, re.MULTILINE))
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    for line in [*project["dependencies"], *extras["milvus"], *extras["test"]]:
        asked = Requirement(line)
        (exact,) = held[canonicalize_name(asked.name)].specifier
        assert asked.specifier.contains(exact.version), line


def test_every_network_that_ships_is_in_the_notice() -> None:
    shipped = [path.name for path in (ROOT / "app").rglob("*.tflite")]
    notice = (ROOT / "NOTICE").read_text()
    assert shipped and [name for name in shipped if name not in notice] == []
