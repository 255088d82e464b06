"""A Milvus server of the PyPI wheel ``milvus``, for tests and measurements."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import platform
import resource
import signal
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import TracebackType

from tests.support.ports import free_ports

_PORTS = (
    "proxy_port",
    "proxy_internal_port",
    "etcd_port",
    "root_coord_port",
    "query_coord_port",
    "query_node_port",
    "index_coord_port",
    "index_node_port",
    "data_coord_port",
    "data_node_port",
)
_PR_SET_PDEATHSIG = 1  # From prctl.h.
_SESSION_TTL_S = "10"
_SOFT_LIMIT = "1536MiB"
_HARD_LIMIT_BYTES = 4 * 1024**3


def why_milvus_cannot_run() -> str | None:
    """Return the reason in a few words, or None where it can."""
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        return "the wheel's Milvus runs on Linux on x86-64"
    if importlib.util.find_spec("milvus") is None:
        return "needs the package milvus"
    if importlib.util.find_spec("pkg_resources") is None:
        return "pymilvus 2.4 needs setuptools<81"
    return None


class MilvusProcess:
    """Milvus standalone on free ports, as a context manager; it ends when its parent does.

    Parameters
    ----------
    folder : Path
        Where programs, configuration and data lie; kept when the server ends.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._ports = dict(zip((*_PORTS, "health"), free_ports(len(_PORTS) + 1), strict=True))
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def address(self) -> str:
        """Host and port."""
        return f"127.0.0.1:{self._ports['proxy_port']}"

    def __enter__(self) -> MilvusProcess:
        """Start it."""
        # The wheel's own class changes the working directory and waits a minimum of two seconds.
        import milvus

        config = milvus.MilvusServerConfig(
            data_dir=str(self._folder), **{name: self._ports[name] for name in _PORTS}
        )
        config.resolve()
        milvus._initialize_data_files(str(self._folder))
        self.start()
        return self

    def start(self) -> None:
        """Start it, or start it again with the data it had."""
        programs = self._folder / "bin"
        with (self._folder / "milvus.log").open("ab") as log:
            self._process = subprocess.Popen(
                [programs / "milvus", "run", "standalone"],
                cwd=self._folder,
                env={
                    **os.environ,
                    "DEPLOY_MODE": "STANDALONE",
                    # After a crash, no part is replaced before its session has expired.
                    "COMMON_SESSION_TTL": _SESSION_TTL_S,
                    "GOMEMLIMIT": _SOFT_LIMIT,
                    "LD_LIBRARY_PATH": str(programs),
                    "METRICS_PORT": str(self._ports["health"]),
                    "MILVUS_RUN_DIR": str(self._folder / "run"),
                },
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=_bind_to_parent,
            )

    def wait_until_healthy(self, timeout_s: float = 60) -> None:
        """Wait until all its parts report that they are well."""
        deadline = time.monotonic() + timeout_s
        while not self._is_healthy():
            if time.monotonic() > deadline:
                raise TimeoutError(f"Milvus did not start in {timeout_s:g} s")
            time.sleep(0.1)

    def kill(self) -> None:
        """End it at once, as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def freeze(self) -> None:
        """Have it neither answer nor refuse."""
        self._signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self._signal(signal.SIGCONT)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it."""
        self.kill()

    def _is_healthy(self) -> bool:
        if self._process is None or self._process.poll() is not None:
            raise RuntimeError(f"Milvus has ended; {self._folder / 'milvus.log'} says why")
        url = f"http://127.0.0.1:{self._ports['health']}/healthz"
        try:
            with urllib.request.urlopen(url, timeout=1) as response:
                return b"OK" in response.read()
        except (urllib.error.URLError, OSError):
            return False

    def _signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)


def _bind_to_parent() -> None:
    """In the child: end when the parent does, and bound the memory."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_DATA, (_HARD_LIMIT_BYTES, _HARD_LIMIT_BYTES))
