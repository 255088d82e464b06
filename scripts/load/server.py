"""A server process, and the frame of every measurement of it: command line, server, conclusion."""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import httpx

from index import DEFAULT_PATH
from index.artefact import load_index
from index.store import PoseIndex
from scripts import figures
from scripts.results import RESULTS, ROOT, percentile


class ServerProcess:
    """``python -m app`` as a context manager."""

    def __init__(self, index: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.url = f"http://127.0.0.1:{port}"
        self._environment = {
            **os.environ,
            "HOST": "127.0.0.1",
            "PORT": str(port),
            "POSE_INDEX": str(index.resolve()),
        }

    def __enter__(self) -> ServerProcess:
        """Start the process."""
        self._started = time.perf_counter()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "app"], cwd=ROOT, env=self._environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        return self

    def wait_until_ready(self, timeout_s: float = 60) -> float:
        """Return the seconds from start to the first 200 of ``/readyz``."""
        while True:
            try:
                if httpx.get(f"{self.url}/readyz").status_code == 200:
                    return time.perf_counter() - self._started
            except httpx.TransportError:
                pass
            if time.perf_counter() - self._started > timeout_s or not self.alive():
                raise TimeoutError(f"the server at {self.url} was not ready in {timeout_s} s")
            time.sleep(0.01)

    def alive(self) -> bool:
        """Return whether the process still runs."""
        return self._process.poll() is None

    def memory_mb(self, what: str = "VmRSS") -> float:
        """Return resident memory in megabytes; ``VmHWM`` for its maximum so far."""
        return _memory_mb(self._process.pid, what)

    def processor_s(self) -> float:
        """Return the processor time spent so far by all threads, seconds."""
        return processor_s(self._process.pid)

    def stop(self) -> int:
        """Ask it to end and return its exit status."""
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(timeout=30)

    def __exit__(self, *error: object) -> None:
        """End the process."""
        if self.alive():
            self.stop()


def processor_s(process: int) -> float:
    """Return the processor time spent so far by all threads of a process, seconds."""
    # The clock of a process, as `clock_getcpuclockid` makes it of the number of the process.
    return time.clock_gettime(~process << 3 | 2)


def _memory_mb(process: int, what: str) -> float:
    status = Path(f"/proc/{process}/status")
    for line in status.read_text().splitlines():
        if line.startswith(f"{what}:"):
            return int(line.split()[1]) / 1024
    raise ValueError(f"expected {what} in {status}")


Figures = dict[str, Any]
Criteria = dict[str, bool]
"""Sentences with what was measured, and whether each meets its criterion."""

Measure = Callable[[ServerProcess, PoseIndex, Any], tuple[Figures, Criteria]]


def run(
    measure: Measure, section: str, option: str, default: float, arguments: Sequence[str] | None
) -> int:
    """Measure a server, print the section, write it where asked for; 1 if a criterion fails.

    ``option`` names how long or how much is measured.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--write", action="store_true", help="into docs/results/reliability")
    parser.add_argument(f"--{option}", dest="amount", type=type(default), default=default)
    options = parser.parse_args(arguments)
    with ServerProcess(options.index) as server:
        server.wait_until_ready()
        found, criteria = measure(server, load_index(options.index), options.amount)
    failed = [what for what, met in criteria.items() if not met]
    command = f"python -m scripts {section} --{option} {options.amount:.12g}"
    out = RESULTS if options.write else None
    figures.report_section(section, command, {**found, "failed": failed}, out)
    return 1 if failed else 0


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum."""
    return {
        "p50": percentile(values, 50),
        "p99": percentile(values, 99),
        "max": max(values, default=0.0),
    }
