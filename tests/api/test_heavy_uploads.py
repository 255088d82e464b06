"""Uploads of a few hundred kilobytes that take gigabytes or minutes are bounded or refused."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.app.vision.encoded import encode
from tests.conftest import HTTP, Server
from tests.support.expensive import (
    bmp,
    gif,
    interlaced_png,
    jpeg,
    tiff_strips,
    tiff_tile,
    webp_animation,
)
from tests.support.service import check_problem

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="the peak memory of a process is unknown"
)

ROWS, COLUMNS = 3000, 4000
REST_MB = 300
"""What a request of the largest allowed images takes beside the service itself."""


@pytest.fixture(autouse=True, scope="module")
def _decodes(server: Server) -> None:
    """From now on, there is a process that decodes."""
    post(server, "/pose", frame=encode(np.zeros((64, 64, 3), np.uint8), ".webp"))


def post(server: Server, path: str, **files: bytes) -> httpx.Response:
    return HTTP.post(f"{server.url}{path}", files=files)


class Use:
    """Memory and processor time that a service and the processes it has started take from now."""

    def __init__(self, server: Server) -> None:
        own = server.process.pid
        children = Path(f"/proc/{own}/task/{own}/children").read_text().split()
        self._processes = [Path("/proc") / str(number) for number in (own, *children)]
        self._before, self._began = self._memory_mb("VmRSS"), self._processor_s()
        for process in self._processes:
            (process / "clear_refs").write_text("5")

    def peak_mb(self) -> int:
        return self._memory_mb("VmHWM") - self._before

    def seconds(self) -> float:
        return self._processor_s() - self._began

    def _memory_mb(self, what: str) -> int:
        status = [(process / "status").read_text().splitlines() for process in self._processes]
        return sum(
            int(line.split()[1]) // 1024 for one in status for line in one if line.startswith(what)
        )

    def _processor_s(self) -> float:
        return sum(time.clock_gettime(~int(one.name) << 3 | 2) for one in self._processes)


def coarse_noise(seed: int) -> bytes:
    noise = np.random.default_rng(seed).integers(0, 256, (ROWS // 8, COLUMNS // 8, 3), np.uint8)
    return encode(cv2.resize(noise, (COLUMNS, ROWS), interpolation=cv2.INTER_NEAREST), ".jpg")


def labelled(labels: NDArray[np.integer]) -> bytes:
    return encode(labels.astype(np.uint8))


def stripes(labels: int) -> bytes:
    return labelled(np.add.outer(np.arange(ROWS), np.arange(COLUMNS)) % labels + 1)


def boxes(count: int) -> bytes:
    return json.dumps([[0, 0, COLUMNS, ROWS]] * count).encode()


@pytest.mark.parametrize(
    ("query", "fields", "refused"),
    [
        ("rle", {"mask": lambda: stripes(50)}, (400, "mask")),
        ("rle", {"frame": lambda: coarse_noise(1), "background": lambda: coarse_noise(2),
                 "boxes": lambda: boxes(4)}, None),
    ],
)  # fmt: skip
def test_memory_of_the_largest_images_is_bounded(
    server: Server, query: str, fields: dict, refused: tuple[int, str] | None
) -> None:
    files = {name: make() for name, make in fields.items()}
    data = {"boxes": files.pop("boxes")} if "boxes" in files else None
    use = Use(server)
    answer = HTTP.post(f"{server.url}/pose?n=1&silhouettes={query}", files=files, data=data)
    assert use.peak_mb() < REST_MB
    if refused:
        check_problem(answer, *refused)
    else:
        assert answer.status_code == 200


@pytest.mark.parametrize(
    "make", [lambda: jpeg(1500), lambda: tiff_tile(6000)], ids=["scans", "tile"]
)
def test_an_expensive_file_is_bounded_wherever_it_is_sent(
    server: Server, make: Callable[[], bytes]
) -> None:
    data, sound = make(), encode(np.zeros((64, 64, 3), np.uint8), ".jpg")
    use = Use(server)
    answers = [
        post(server, "/pose?n=1", frame=data),
        post(server, "/pose?n=1", mask=data),
        post(server, "/pose?n=1", frame=sound, background=data),
        post(server, "/pose/overlay", frame=data),
        post(server, "/silhouette", frame=data),
        post(server, "/v1/vision/detection", image=data),
        post(server, "/cameras/a/frames", frame=data),
        HTTP.post(f"{server.url}/pose", content=data, headers={"Content-Type": "image/x"}),
    ]
    assert {answer.status_code for answer in answers} == {400}
    assert use.peak_mb() <= 120
    assert use.seconds() < 4


@pytest.mark.parametrize(
    "make",
    [lambda: jpeg(30), interlaced_png, tiff_strips, lambda: gif(2000),
     lambda: webp_animation(300), bmp],
    ids=["JPEG", "PNG", "TIFF", "GIF", "WebP", "BMP"],
)  # fmt: skip
def test_files_of_all_formats_are_bounded(server: Server, make: Callable[[], bytes]) -> None:
    data = make()
    use = Use(server)
    answer = HTTP.post(f"{server.url}/pose", files={"frame": data}, data={"boxes": "[]"})
    assert answer.status_code in (200, 400, 413)
    assert use.peak_mb() <= 350
    assert use.seconds() < 3
