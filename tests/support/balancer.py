"""HAProxy with ``deploy/haproxy.cfg`` before server processes."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import httpx

from tests.conftest import ROOT
from tests.support.ports import free_ports

CONFIGURATION = ROOT / "deploy" / "haproxy.cfg"


class Balancer:
    """A balancer process on free ports before servers with these URLs, as a context manager."""

    def __init__(
        self,
        *replicas: str,
        configuration: Path = CONFIGURATION,
        log: Path | None = None,
        **environment: str,
    ) -> None:
        service, operations = (f"127.0.0.1:{port}" for port in free_ports(2))
        self.url, self.operations_url = f"http://{service}", f"http://{operations}"
        self._environment = {
            **os.environ,
            "BIND": service,
            "OPERATIONS_BIND": operations,
            **{
                f"REPLICA_{number}": url.removeprefix("http://")
                for number, url in enumerate(replicas, start=1)
            },
            **environment,
        }
        self._configuration = configuration
        self._log = log or Path(os.devnull)

    def __enter__(self) -> Balancer:
        """Start it, and wait until it has a replica to ask."""
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                ["haproxy", "-db", "-f", str(self._configuration)],
                env=self._environment,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        try:
            self._wait_until_ready()
        except TimeoutError:
            self.__exit__()
            raise
        return self

    def _wait_until_ready(self, timeout_s: float = 20) -> None:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline and self._process.poll() is None:
            try:
                if httpx.get(f"{self.operations_url}/readyz").status_code == 200:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.02)
        raise TimeoutError(f"the balancer at {self.url} was not ready in {timeout_s} s")

    def __exit__(self, *error: object) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait(timeout=10)
