"""A server process that is killed and restarted on its port."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT, wait_until
from tests.support.ports import free_ports


class Replica:
    """``python -m app`` as a context manager; entering it again restarts it."""

    def __init__(self, index: Path, log: Path | None = None) -> None:
        (port,) = free_ports(1)
        self.url = f"http://127.0.0.1:{port}"
        self._environment = {
            **os.environ, "HOST": "127.0.0.1", "PORT": str(port), "POSE_INDEX": str(index),
        }  # fmt: skip
        self._log = log or Path(os.devnull)

    def __enter__(self) -> Replica:
        """Start it."""
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "app"], cwd=ROOT, env=self._environment,
                stdout=log, stderr=subprocess.STDOUT,
            )  # fmt: skip
        return self

    def wait_until_ready(self) -> None:
        """Wait for the first 200 of ``/readyz``."""
        wait_until(f"{self.url}/readyz", timeout_s=60)

    def stop(self) -> int:
        """Ask it to end and return its exit status."""
        self._process.terminate()
        return self._process.wait(timeout=30)

    def kill(self) -> None:
        """End it as a crash would, with nothing finished."""
        self._process.kill()
        self._process.wait()

    def __exit__(self, *error: object) -> None:
        """End it."""
        if self._process.poll() is None:
            self.stop()
