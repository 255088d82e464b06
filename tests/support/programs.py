"""Programs that run until they end by themselves."""

import os
import subprocess
from pathlib import Path

from tests.conftest import ROOT


def run(
    *command: str | Path, cwd: Path = ROOT, timeout_s: float = 300, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a program, with more in its environment; return what became of it."""
    return subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, timeout=timeout_s,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def output_of(*command: str | Path, cwd: Path = ROOT, **environment: str) -> str:
    """Run a program that has to succeed; return what it writes."""
    ended = run(*command, cwd=cwd, **environment)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout
