"""Uploads of a few hundred kilobytes that would take gigabytes or minutes are refused."""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.conftest import Server, running_server
from tests.support.service import check_problem

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="the peak memory of a process is unknown"
)

ROWS, COLUMNS = 3000, 4000
REST_MB = 300
"""What a request of the largest allowed images takes beside the service itself."""


@pytest.fixture(scope="module")
def patient(index_path: Path) -> Iterator[Server]:
    with running_server(index_path, POSE_REQUEST_TIMEOUT_S="300") as running:
        yield running


def memory_mb(server: Server, kind: str) -> int:
    status = Path(f"/proc/{server.process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) // 1024 for line in status if line.startswith(kind))


def encode(image: NDArray[np.integer], extension: str = ".png") -> bytes:
    return cv2.imencode(extension, image.astype(np.uint8))[1].tobytes()


def coarse_noise(seed: int) -> bytes:
    noise = np.random.default_rng(seed).integers(0, 256, (ROWS // 8, COLUMNS // 8, 3), np.uint8)
    return encode(cv2.resize(noise, (COLUMNS, ROWS), interpolation=cv2.INTER_NEAREST), ".jpg")


def stripes(labels: int) -> bytes:
    return encode(np.add.outer(np.arange(ROWS), np.arange(COLUMNS)) % labels + 1)


def squares(labels: int, side: int = 32) -> bytes:
    """People who reach over all but the frame's border, each in hundreds of pieces."""
    rows, columns = np.arange(ROWS) // side, np.arange(COLUMNS) // side
    people = np.add.outer(rows, columns) % labels + 1
    people[[0, -1]] = people[:, [0, -1]] = 0
    return encode(people)


def two_values() -> bytes:
    return encode(np.random.default_rng(0).integers(0, 2, (ROWS, COLUMNS)))


def boxes(count: int) -> bytes:
    return json.dumps([[0, 0, COLUMNS, ROWS]] * count).encode()


@pytest.mark.parametrize(
    ("query", "fields", "refused"),
    [
        ("rle", {"mask": lambda: stripes(50)}, (400, "mask")),
        ("none", {"mask": two_values}, (400, "mask")),
        ("rle", {"mask": lambda: squares(5)}, (422, "mask")),
        ("rle", {"mask": lambda: squares(4)}, None),
        ("polygon", {"mask": lambda: squares(4), "frame": lambda: coarse_noise(1)}, None),
        ("none", {name: lambda: coarse_noise(1) for name in ("frame", "background")}
         | {"boxes": lambda: boxes(50)}, (422, "boxes")),
        ("rle", {"frame": lambda: coarse_noise(1), "background": lambda: coarse_noise(2),
                 "boxes": lambda: boxes(4)}, None),
        ("rle", {"frame": lambda: coarse_noise(1), "boxes": lambda: boxes(4)}, None),
    ],
)  # fmt: skip
def test_memory_is_bounded(
    patient: Server, query: str, fields: dict, refused: tuple[int, str] | None
) -> None:
    files = {name: make() for name, make in fields.items()}
    data = {"boxes": files.pop("boxes")} if "boxes" in files else None
    before = memory_mb(patient, "VmRSS")
    Path(f"/proc/{patient.process.pid}/clear_refs").write_text("5")
    answer = httpx.post(
        f"{patient.url}/pose?n=1&silhouettes={query}", files=files, data=data, timeout=300
    )
    assert memory_mb(patient, "VmHWM") - before < REST_MB
    if refused:
        check_problem(answer, *refused)
    else:
        assert answer.status_code == 200
