"""Programs that run until they end by themselves."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


def children() -> set[int]:
    """Numbers of the processes that this one has started and that have not ended."""
    lists = Path("/proc/self/task").glob("*/children")
    return {int(number) for one in lists for number in one.read_text().split()}


@contextmanager
def none_left_running() -> Iterator[None]:
    """End what was started inside and has not ended, also after a failure."""
    before = children()
    try:
        yield
    finally:
        for number in children() - before:
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(number, signal.SIGKILL)
                os.waitpid(number, 0)
