"""A build ended by ``kill -9`` leaves the old index intact, and the next build cleans up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from index.artefact import load_index, save_index
from tests.conftest import ROOT, build_tiny_index

pytestmark = pytest.mark.slow
MOCAP = Path(os.environ.get("SHARED", ROOT / ".." / "shared")) / "mocap"
SLOWEST_S = 300


def start_build(out: Path) -> subprocess.Popen[bytes]:
    size = ["--entries", "240", "--bodies", "1", "--views", "6", "--descriptor", "paper"]
    command = [sys.executable, "-m", "scripts", "build", "--mocap", str(MOCAP), *size]
    return subprocess.Popen(
        [*command, "--out", str(out)], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT
    )


def kill_once(build: subprocess.Popen[bytes], due: Callable[[], bool]) -> None:
    until = time.monotonic() + SLOWEST_S
    while not due():
        assert build.poll() is None, f"the build ended by itself with {build.returncode}"
        assert time.monotonic() < until
        time.sleep(0.0005)
    build.send_signal(signal.SIGKILL)
    assert build.wait() == -signal.SIGKILL


def test_a_killed_build_leaves_the_old_index_intact(tmp_path: Path) -> None:
    pytest.importorskip("anny", reason="needs the build extra")
    if not MOCAP.exists():
        pytest.skip(f"needs the motion data in {MOCAP}")
    out = tmp_path / "index"
    version = save_index(build_tiny_index(), out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}

    def beside(pattern: str) -> list[Path]:
        try:
            return list(tmp_path.glob(f".index-*/{pattern}"))
        except FileNotFoundError:  # The folder was removed meanwhile.
            return []

    def staged() -> list[Path]:
        return beside("new/*.xz") + beside("new/*.npy")

    started = time.monotonic()
    # While it computes; with a shard drawn; with the first file written; with several.
    for due in (
        lambda: time.monotonic() > started + 3,
        lambda: len(beside("shard-*")) >= 1,
        lambda: len(staged()) >= 1,
        lambda: len(staged()) >= 4,
    ):
        kill_once(start_build(out), due)
        assert {path.name: path.read_bytes() for path in out.iterdir()} == before
        assert load_index(out).version == version

    assert staged()
    assert start_build(out).wait(timeout=SLOWEST_S) == 0
    assert load_index(out).version != version
    assert [path.name for path in tmp_path.iterdir()] == ["index"]
