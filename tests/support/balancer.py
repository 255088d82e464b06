"""HAProxy with ``deploy/haproxy.cfg`` before server processes."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from tests.conftest import ROOT, start_server, wait_until
from tests.support.ports import free_ports

CONFIGURATION = ROOT / "deploy" / "haproxy.cfg"


class Replica:
    """A server process that is ready, as a context manager; entering it again restarts it."""

    def __init__(self, index: Path, log: Path | None = None) -> None:
        (self._port,) = free_ports(1)
        self.url = f"http://127.0.0.1:{self._port}"
        self._index, self._log = index, log

    def __enter__(self) -> Replica:
        self._server = start_server(self._index, log=self._log, PORT=str(self._port))
        wait_until(f"{self.url}/readyz", timeout_s=60)
        return self

    def kill(self) -> None:
        """End it as a crash would, with no request finished."""
        self._server.process.kill()
        self._server.process.wait()

    def __exit__(self, *error: object) -> None:
        if self._server.process.poll() is None:
            self._server.stop()


class Balancer:
    """A balancer process on free ports before servers with these URLs, as a context manager."""

    def __init__(self, *replicas: str, log: Path | None = None) -> None:
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
        }
        self._log = log or Path(os.devnull)

    def __enter__(self) -> Balancer:
        """Start it, and wait until one of its replicas is ready."""
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                ["haproxy", "-db", "-f", str(CONFIGURATION)],
                env=self._environment,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        try:
            wait_until(f"{self.operations_url}/readyz")
        except TimeoutError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        self._process.wait(timeout=60)
