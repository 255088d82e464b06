"""Valid images that are small and expensive cost what others cost, wherever they are sent."""

import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from scripts.load.expensive import expensive, jpeg, png, tiff_tile, webp_codes
from tests.app.vision.encoded import encode
from tests.conftest import Server, running_server

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/clear_refs").exists(), reason="the peak memory of a process is unknown"
)

FILES = {
    "scans": lambda: jpeg(1500),
    "texts": lambda: png(60),
    "tile": lambda: tiff_tile(12288),
    "codes": webp_codes,
}


@pytest.fixture(scope="module")
def server(index_path: Path) -> Iterator[Server]:
    with running_server(index_path, POSE_REQUEST_TIMEOUT_S="60") as running:
        small = encode(np.zeros((64, 64, 3), np.uint8), ".webp")
        post(running, "/pose", frame=small)  # From now on, there is a process that decodes.
        yield running


def post(server: Server, path: str, **files: bytes) -> httpx.Response:
    return httpx.post(f"{server.url}{path}", files=files, timeout=60)


def processes(server: Server) -> list[Path]:
    own = server.process.pid
    children = Path(f"/proc/{own}/task/{own}/children").read_text().split()
    return [Path("/proc") / str(number) for number in (own, *children)]


def memory_mb(server: Server, what: str) -> int:
    status = [(process / "status").read_text().splitlines() for process in processes(server)]
    return sum(
        int(line.split()[1]) // 1024 for one in status for line in one if line.startswith(what)
    )


def processor_s(server: Server) -> float:
    return sum(time.clock_gettime(~int(one.name) << 3 | 2) for one in processes(server))


@pytest.mark.parametrize("kind", FILES)
def test_it_is_bounded_wherever_it_is_sent(server: Server, kind: str) -> None:
    data, sound = FILES[kind](), encode(np.zeros((64, 64, 3), np.uint8), ".jpg")
    before, began = memory_mb(server, "VmRSS"), processor_s(server)
    for process in processes(server):
        (process / "clear_refs").write_text("5")
    answers = [
        post(server, "/pose?n=1", frame=data),
        post(server, "/pose?n=1", mask=data),
        post(server, "/pose?n=1", frame=sound, background=data),
        post(server, "/pose/overlay", frame=data),
        post(server, "/silhouette", frame=data),
        post(server, "/v1/vision/detection", image=data),
        post(server, "/cameras/a/frames", frame=data),
        httpx.post(f"{server.url}/pose", content=data, headers={"Content-Type": "image/x"}),
    ]
    # A PNG with texts is a sound picture, though not of people.
    allowed = {200, 400, 422} if kind == "texts" else {400}
    assert {answer.status_code for answer in answers} <= allowed
    assert memory_mb(server, "VmHWM") - before <= 120
    assert processor_s(server) - began < 4


def test_files_of_all_formats_are_bounded(server: Server) -> None:
    for kind, data in expensive().items():
        before, began = memory_mb(server, "VmRSS"), processor_s(server)
        for process in processes(server):
            (process / "clear_refs").write_text("5")
        answer = httpx.post(
            f"{server.url}/pose", files={"frame": data}, data={"boxes": "[]"}, timeout=60
        )
        assert answer.status_code in (200, 400, 413), kind
        assert memory_mb(server, "VmHWM") - before <= 350, kind
        assert processor_s(server) - began < 3, kind
