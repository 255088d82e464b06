"""The tiny index of drawn stick figures and the one that ships, and services over both."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# As in the service; NumPy reads it when it is imported. With more threads, tests that run beside
# one another take three times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck
from hypothesis import settings as property_settings
from numpy.typing import NDArray

from app.main import create_app
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from index.artefact import load_index
from index.store import PoseIndex
from tests.golden.pictures import png
from tests.support.ports import free_ports

# No deadlines: the machine may be busy. With 40 examples, the suite notices what it does with 100.
property_settings.register_profile(
    "untimed", deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
property_settings.load_profile("untimed")

ROOT = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("SHARED", ROOT.parent / "shared")).resolve()
"""Data beside the project; tests that need them skip where they are absent."""

INDEXES = ROOT / "tests" / "data" / "indexes"
"""Of stick figures, written by ``python -m tests.support.toy_indexes``."""

WALKERS = ROOT / "tests" / "data" / "walkers.jpg"
"""A street with three walkers and two distant people."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files next to the root of the tests, which start the most.

    None of them is to be left at the end, when the other processes have nothing to do.
    """
    items.sort(key=lambda item: len(item.path.parts))


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """Asynchronous tests run on asyncio, like the service."""
    return "asyncio"


@pytest.fixture(scope="session")
def index_path() -> Path:
    """Folder of the tiny index."""
    return INDEXES / "sticks"


@pytest.fixture(scope="session")
def tiny_index(index_path: Path) -> PoseIndex:
    """The tiny index, loaded."""
    return load_index(index_path)


@dataclass(frozen=True)
class Photo:
    """A frame (240, 320, 3) of a known entry, the mask of the person, and where joints are."""

    entry: int
    frame: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    joints_2d: NDArray[np.float64]

    @property
    def frame_png(self) -> bytes:
        """The frame, encoded."""
        return png(self.frame)

    @property
    def mask_png(self) -> bytes:
        """The mask, encoded."""
        return png(self.mask)

    @property
    def files(self) -> dict[str, bytes]:
        """Frame and mask as parts of a form."""
        return {"frame": self.frame_png, "mask": self.mask_png}


def photograph(index: PoseIndex, number: int, left: int = 150, top: int = 40) -> Photo:
    """An entry's silhouette in dark grey before a noisy light wall."""
    rng = np.random.default_rng(number)
    frame = rng.integers(170, 230, (240, 320, 3), np.uint8)
    mask = np.zeros((240, 320), np.uint8)
    silhouette = index.silhouette(number)
    mask[top : top + 128, left : left + 48] = silhouette
    frame[mask == 1] = (60, 50, 70)
    joints = index.entry(number).points_normalised[:19] + np.array([left, top])
    return Photo(number, frame, mask, joints)


@pytest.fixture(scope="session")
def photo(tiny_index: PoseIndex) -> Photo:
    """A photograph of entry 8."""
    return photograph(tiny_index, 8)


PATIENT_S = 300
"""How long services of tests let a frame wait and take: the machine may be busy."""

HTTP = httpx.Client(timeout=PATIENT_S)
"""For requests to servers: to set up a client takes longer than most answers."""


@pytest.fixture(scope="session")
def settings(index_path: Path) -> Settings:
    """Settings for the tiny index."""
    return Settings(index=index_path, max_wait_s=PATIENT_S, request_timeout_s=PATIENT_S)


@pytest.fixture(scope="session")
def estimator(settings: Settings) -> Estimator:
    """An estimator over the tiny index."""
    return load_estimator(settings)


@pytest.fixture(scope="session")
def shipped() -> Estimator:
    """An estimator over the index that ships; it takes seconds to load."""
    return load_estimator(Settings())


@pytest.fixture
def client(settings: Settings, estimator: Estimator) -> Iterator[TestClient]:
    """A client of an application over the tiny index."""
    with TestClient(create_app(settings, estimator), raise_server_exceptions=False) as client:
        yield client


@dataclass(frozen=True)
class Server:
    """A running server process."""

    url: str
    process: subprocess.Popen[bytes]

    def stop(self) -> int:
        """Ask it to end and return its exit status."""
        self.process.terminate()
        return self.process.wait(timeout=60)


def start_server(
    index: Path | None,
    root: Path = ROOT,
    python: Path | str = sys.executable,
    log: Path | None = None,
    **environment: str,
) -> Server:
    """Start ``python -m app`` in ``root`` on a free port; it may not be ready yet.

    Without an index, it serves the one of its package.
    """
    variables = {
        "HOST": "127.0.0.1",
        "PORT": str(free_ports(1)[0]),
        "POSE_MAX_WAIT_S": str(PATIENT_S),
        "POSE_REQUEST_TIMEOUT_S": str(PATIENT_S),
        **environment,
    }
    if index:
        variables.setdefault("POSE_INDEX", str(index))
    with log.open("ab") if log else nullcontext() as output:
        process = subprocess.Popen(
            [python, "-m", "app"],
            cwd=root,
            env={**os.environ, **variables},
            stdout=output,
            stderr=subprocess.STDOUT if output else None,
        )
    return Server(f"http://127.0.0.1:{variables['PORT']}", process)


def wait_until(url: str, status: int = 200, timeout_s: float = 60) -> httpx.Response:
    """Poll until a URL answers with a status."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            response = HTTP.get(url)
            if response.status_code == status:
                return response
        except httpx.TransportError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError(f"{url} did not answer with {status} in {timeout_s} s")
        time.sleep(0.02)


@contextmanager
def running_server(
    index: Path | None, timeout_s: float = PATIENT_S, **options: Any
) -> Iterator[Server]:
    """Start a server as :func:`start_server` does, wait until it is ready, and end it."""
    running = start_server(index, **options)
    try:
        wait_until(f"{running.url}/readyz", timeout_s=timeout_s)
        yield running
    finally:
        assert running.stop() == 0


@pytest.fixture(scope="session")
def server(index_path: Path) -> Iterator[Server]:
    """A server process over the tiny index, ready."""
    with running_server(index_path) as running:
        yield running


@pytest.fixture(scope="session")
def shipped_server() -> Iterator[Server]:
    """A server process over the index that ships, ready."""
    with running_server(None) as running:
        yield running


Serving = Callable[..., TestClient]


@pytest.fixture(scope="session")
def serving(settings: Settings, estimator: Estimator) -> Serving:
    """Makes a client of an application over the tiny index with some settings changed."""

    def make(**changed: object) -> TestClient:
        return TestClient(create_app(settings.model_copy(update=changed), estimator))

    return make
