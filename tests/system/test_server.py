"""The service as a process: a broken index, overload, hang-ups, the end."""

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from tests.conftest import Server, running_server, start_server, wait_until
from tests.support.service import eventually, sample


@pytest.fixture(scope="module")
def slow_frame() -> bytes:
    """A large frame full of edges, which takes long to search for people."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (90, 160, 3), np.uint8)
    frame = cv2.resize(coarse, (1280, 720), interpolation=cv2.INTER_NEAREST)
    return cv2.imencode(".jpg", frame)[1].tobytes()


@pytest.fixture
def narrow(index_path: Path) -> Iterator[Server]:
    """A server that works on one frame at a time."""
    with running_server(index_path, POSE_CONCURRENCY="1", POSE_MAX_WAIT_S="1") as running:
        yield running


def value(server: Server, metric: str, **labels: str) -> float:
    with httpx.Client(base_url=server.url) as client:
        return sample(client, metric, **labels) or 0.0


def test_overload_is_refused_at_once(narrow: Server, slow_frame: bytes) -> None:
    def ask(_: int) -> tuple[int, float, str | None]:
        started = time.perf_counter()
        response = httpx.post(f"{narrow.url}/pose", files={"frame": slow_frame}, timeout=30)
        seconds = time.perf_counter() - started
        return response.status_code, seconds, response.headers.get("retry-after")

    ask(0)  # From now on it knows what such a frame takes.
    # A fast machine serves a dozen within the second that a frame may wait.
    with ThreadPoolExecutor(30) as clients:
        answers = list(clients.map(ask, range(30)))
    accepted = [seconds for status, seconds, _ in answers if status == 200]
    refused = [(seconds, after) for status, seconds, after in answers if status == 503]
    assert len(accepted) + len(refused) == 30
    assert accepted
    assert len(refused) >= 10
    assert all(int(after or 0) >= 1 for _, after in refused)
    assert np.median([seconds for seconds, _ in refused]) < max(accepted)
    assert value(narrow, "pose_rejected_total", reason="overloaded") == len(refused)


def test_sigterm_finishes_all_frames_and_exits_with_status_0(
    index_path: Path, slow_frame: bytes
) -> None:
    running = start_server(
        index_path, POSE_CONCURRENCY="2", POSE_MAX_WAIT_S="60", POSE_REQUEST_TIMEOUT_S="60"
    )
    wait_until(f"{running.url}/readyz", timeout_s=120)
    boxes = json.dumps([[40 * column, 100, 38, 100] for column in range(3)])

    def ask(_: int) -> int:
        files, data = {"frame": slow_frame}, {"boxes": boxes}
        return httpx.post(f"{running.url}/pose", files=files, data=data, timeout=60).status_code

    with ThreadPoolExecutor(3) as clients:
        answers = [clients.submit(ask, number) for number in range(3)]
        eventually(lambda: value(running, "pose_in_flight") == 3 or any(a.done() for a in answers))
        assert running.stop() == 0
        assert [answer.result() for answer in answers] == [200, 200, 200]
