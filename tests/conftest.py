"""A tiny index of drawn stick figures, an application over it and a server process."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# As in the service; NumPy reads it when it is imported. With more threads, tests that run beside
# one another take three times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
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
from descriptor.descriptor import DiagonalDescriptor
from descriptor.silhouette import normalise, pack
from index.artefact import load_index
from index.confidence import FEATURES, Calibration, signs
from index.search import ExactNeighbours
from index.skeleton import NATIVE, POINT_NAMES, camera_rotation, project
from index.store import ENTRY_DTYPE, SKELETON_DTYPE, PoseIndex
from scripts.index.writer import compress, save_index
from tests.golden.pictures import png
from tests.support.ports import free_ports

# No deadlines: the machine may be busy.
property_settings.register_profile(
    "untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
property_settings.load_profile("untimed")

ROOT = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("SHARED", ROOT.parent / "shared")).resolve()
"""Data beside the project; tests that need them skip where they are absent."""

PIXELS_PER_METRE = 100.0
CANVAS = 256
WALKERS = ROOT / "tests" / "data" / "walkers.jpg"
"""A street with three walkers and two distant people."""

CAMERA_DISTANCE_M = 4.0
CALIBRATION = Calibration(tuple((0.3 * signs(FEATURES)).tolist()), 1.0)
"""Higher where a hypothesis is near, fits well and has many votes."""


Limbs = tuple[float, float, float, float, float]
"""Of one side, radians: arm ahead, elbow bent, leg ahead, knee bent, arm aside."""


def stick_figure(rng: np.random.Generator) -> NDArray[np.float64]:
    """A random pose ``(24, 3)`` in body axes: a standing person who swings arms and legs."""
    return posed_figure(
        *(
            (*rng.uniform((-1.2, 0, -0.8, 0), (1.2, 1.4, 0.8, 1.0)), rng.uniform(0.1, 1.5))
            for _ in range(2)
        )
    )


def posed_figure(left: Limbs, right: Limbs) -> NDArray[np.float64]:
    """A standing person ``(24, 3)`` in body axes."""
    points = dict.fromkeys(POINT_NAMES, np.zeros(3))
    points["spine"], points["chest"] = np.array([0, 0.12, 0]), np.array([0, 0.3, 0])
    points["neck"], points["head"] = np.array([0, 0.52, 0]), np.array([0, 0.66, 0.03])
    for side, sign, limbs in (("left", 1.0, left), ("right", -1.0, right)):
        arm, elbow, leg, knee, spread = limbs
        points[f"{side}_shoulder"] = np.array([0.18 * sign, 0.46, 0])
        points[f"{side}_elbow"] = points[f"{side}_shoulder"] + 0.28 * _swing(arm, spread * sign)
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + 0.26 * _swing(
            arm + elbow, spread * sign
        )
        points[f"{side}_hip"] = np.array([0.1 * sign, -0.04, 0])
        points[f"{side}_knee"] = points[f"{side}_hip"] + 0.42 * _swing(leg, 0.1 * sign)
        points[f"{side}_ankle"] = points[f"{side}_knee"] + 0.42 * _swing(leg - knee, 0.1 * sign)
        points[f"{side}_toe"] = points[f"{side}_ankle"] + np.array([0, -0.03, 0.16])
        points[f"{side}_eye"] = points["head"] + np.array([0.03 * sign, 0.03, 0.09])
        points[f"{side}_ear"] = points["head"] + np.array([0.07 * sign, 0.0, 0.01])
    points["nose"] = points["head"] + np.array([0, 0, 0.11])
    return np.array([points[name] for name in POINT_NAMES])


def _swing(forward: float, aside: float) -> NDArray[np.float64]:
    """Unit vector of a limb that hangs, swung forward and aside by angles in radians."""
    return np.array(
        [np.sin(aside) * np.cos(forward), -np.cos(aside) * np.cos(forward), np.sin(forward)]
    )


def draw_figure(plane: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Silhouette ``(256, 256)`` of 0 and 1 of a figure given in metres ``(24, 2)``."""
    pixels = np.round(plane * PIXELS_PER_METRE + CANVAS / 2).astype(int)
    canvas = np.zeros((CANVAS, CANVAS), np.uint8)
    for parent, child in NATIVE.bones:
        cv2.line(canvas, pixels[parent].tolist(), pixels[child].tolist(), 1, 11)
    torso = [POINT_NAMES.index(f"{s}_{j}") for j in ("shoulder", "hip") for s in ("left", "right")]
    cv2.fillConvexPoly(canvas, cv2.convexHull(pixels[torso]), 1)
    cv2.circle(canvas, pixels[POINT_NAMES.index("head")].tolist(), 11, 1, -1)
    return canvas


def draw_view(
    skeleton: NDArray[np.float64], azimuth_deg: float, elevation_deg: float, roll_deg: float = 0.0
) -> tuple[NDArray[np.uint8], dict[str, float]]:
    """The normalised silhouette of a figure ``(24, 3)``, and its camera and placement."""
    points = skeleton @ camera_rotation(azimuth_deg, elevation_deg, roll_deg).T
    silhouette, placement = normalise(draw_figure(project(points, CAMERA_DISTANCE_M)))
    offset_x, offset_y = placement.to_normalised([CANVAS / 2, CANVAS / 2])
    return silhouette, {
        "azimuth_deg": azimuth_deg,
        "elevation_deg": elevation_deg,
        "roll_deg": roll_deg,
        "distance": CAMERA_DISTANCE_M,
        "scale": placement.scale * PIXELS_PER_METRE,
        "offset_x": offset_x,
        "offset_y": offset_y,
    }


def index_of_figures(
    name: str,
    skeletons: NDArray[np.float64],
    views: Sequence[tuple[NDArray[np.uint8], dict[str, float]]],
    action: NDArray[np.integer],
    actions: tuple[str, ...] = ("walk", "jump"),
) -> PoseIndex:
    """An index of figures ``(S, 24, 3)``, each with equally many views of :func:`draw_view`."""
    entries = np.zeros(len(views), ENTRY_DTYPE)
    entries["skeleton"] = np.arange(len(views)) // (len(views) // len(skeletons))
    for entry, (_, camera) in zip(entries, views, strict=True):
        for field, value in camera.items():
            entry[field] = value
    labels = np.zeros(len(skeletons), SKELETON_DTYPE)
    labels["frame"], labels["action"] = np.arange(len(skeletons)), action
    descriptor = DiagonalDescriptor()
    stack = np.array([silhouette for silhouette, _ in views])
    return PoseIndex(
        name=name,
        descriptor=descriptor,
        vectors=ExactNeighbours(descriptor.describe(stack)),
        entries=entries,
        skeletons=skeletons.astype(np.float16),
        skeleton_labels=labels,
        clips=("sticks_01",),
        subjects=("stick",),
        actions=actions,
        silhouette_store=compress(pack(stack)),
        parameters={
            "seed": 1,
            "attribution": "Drawn for tests.",
            "confidence": CALIBRATION.parameters(),
        },
    )


def build_tiny_index(poses: int = 24, views: int = 4, seed: int = 1) -> PoseIndex:
    """An index of random stick figures: ``poses * views`` entries."""
    rng = np.random.default_rng(seed)
    skeletons = np.array([stick_figure(rng) for _ in range(poses)])
    # No view exactly from the side: rounding would decide which way it faces.
    drawn = [
        draw_view(skeleton, 20.0 + 360.0 / views * view, 10.0)
        for skeleton in skeletons
        for view in range(views)
    ]
    return index_of_figures("sticks", skeletons, drawn, np.arange(poses) % 2)


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """Asynchronous tests run on asyncio, like the service."""
    return "asyncio"


@pytest.fixture(scope="session")
def index_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the tiny index."""
    path = tmp_path_factory.mktemp("index") / "sticks"
    save_index(build_tiny_index(), path)
    return path


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


@pytest.fixture(scope="session")
def settings(index_path: Path) -> Settings:
    """Settings for the tiny index."""
    return Settings(index=index_path)


@pytest.fixture(scope="session")
def estimator(settings: Settings) -> Estimator:
    """An estimator over the tiny index."""
    return load_estimator(settings)


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
        return self.process.wait(timeout=20)


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
    variables = {"HOST": "127.0.0.1", "PORT": str(free_ports(1)[0]), **environment}
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


def wait_until(url: str, status: int = 200, timeout_s: float = 20) -> httpx.Response:
    """Poll until a URL answers with a status."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            response = httpx.get(url)
            if response.status_code == status:
                return response
        except httpx.TransportError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError(f"{url} did not answer with {status} in {timeout_s} s")
        time.sleep(0.02)


@contextmanager
def running_server(index: Path | None, timeout_s: float = 120, **options: Any) -> Iterator[Server]:
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


Serving = Callable[..., TestClient]


@pytest.fixture(scope="session")
def serving(settings: Settings, estimator: Estimator) -> Serving:
    """Makes a client of an application over the tiny index with some settings changed."""

    def make(**changed: object) -> TestClient:
        return TestClient(create_app(settings.model_copy(update=changed), estimator))

    return make
