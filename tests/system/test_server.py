"""The service as a process: start, probes, overload, hang-ups, the end."""

from __future__ import annotations

import json
import shutil
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from tests.conftest import Photo, Server, running_server, start_server, wait_until
from tests.support.service import check_problem, eventually, sample


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
    with running_server(index_path, POSE_CONCURRENCY="1", POSE_MAX_WAIT_S="2") as running:
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
    # A fast machine serves a dozen within the two seconds that a frame may wait.
    with ThreadPoolExecutor(40) as clients:
        answers = list(clients.map(ask, range(40)))
    accepted = [seconds for status, seconds, _ in answers if status == 200]
    refused = [(seconds, after) for status, seconds, after in answers if status == 503]
    assert len(accepted) + len(refused) == 40
    assert accepted
    assert len(refused) >= 20
    assert all(int(after or 0) >= 1 for _, after in refused)
    assert np.median([seconds for seconds, _ in refused]) < max(accepted)
    assert value(narrow, "pose_rejected_total", reason="overloaded") == len(refused)


def test_frames_of_disconnected_clients_are_dropped(narrow: Server, slow_frame: bytes) -> None:
    def ask_and_hang_up(_: int) -> None:
        with pytest.raises(httpx.ReadTimeout):
            httpx.post(f"{narrow.url}/pose", files={"frame": slow_frame}, timeout=0.06)

    with ThreadPoolExecutor(3) as clients:
        list(clients.map(ask_and_hang_up, range(3)))
    eventually(lambda: value(narrow, "pose_in_flight") == 0)
    assert value(narrow, "pose_rejected_total", reason="client_gone") >= 2
    # Two of the three never got further than the queue.
    assert value(narrow, "pose_stage_seconds_count", stage="total") <= 1


def test_sigterm_finishes_all_frames_and_exits_with_status_0(
    index_path: Path, slow_frame: bytes
) -> None:
    running = start_server(index_path, POSE_CONCURRENCY="2", POSE_MAX_WAIT_S="10")
    wait_until(f"{running.url}/readyz")
    boxes = json.dumps([[40 * column, 100, 38, 100] for column in range(8)])

    def ask(_: int) -> int:
        files, data = {"frame": slow_frame}, {"boxes": boxes}
        return httpx.post(f"{running.url}/pose", files=files, data=data, timeout=30).status_code

    with ThreadPoolExecutor(3) as clients:
        answers = [clients.submit(ask, number) for number in range(3)]
        eventually(lambda: value(running, "pose_in_flight") == 3 or any(a.done() for a in answers))
        assert running.stop() == 0
        assert [answer.result() for answer in answers] == [200, 200, 200]


def test_a_corrupted_index_is_reported_and_not_served(index_path: Path, tmp_path: Path) -> None:
    corrupted = tmp_path / "index"
    shutil.copytree(index_path, corrupted)
    vectors = corrupted / "descriptors.faiss.xz"
    vectors.write_bytes(vectors.read_bytes()[:-10])
    running = start_server(corrupted)
    try:
        wait_until(f"{running.url}/healthz")
        ready = partial(httpx.get, f"{running.url}/readyz")
        eventually(lambda: "truncated" in check_problem(ready(), 503))
        check_problem(httpx.post(f"{running.url}/pose", files={"frame": b"x"}), 503)
    finally:
        assert running.stop() == 0


def test_a_slow_upload_gets_a_408(index_path: Path) -> None:
    def trickle() -> Iterator[bytes]:
        yield b'--b\r\nContent-Disposition: form-data; name="frame"; filename="f"\r\n\r\n'
        for _ in range(20):
            yield b"x"
            time.sleep(0.1)

    headers = {"content-type": "multipart/form-data; boundary=b"}
    # The connection may be closed while the client still writes.
    with (
        running_server(index_path, POSE_UPLOAD_TIMEOUT_S="0.3") as running,
        suppress(httpx.WriteError),
    ):
        response = httpx.post(f"{running.url}/pose", content=trickle(), headers=headers)
        assert response.status_code == 408


def test_stalled_uploads_do_not_block_others(index_path: Path, photo: Photo) -> None:
    head = (
        b"POST /pose HTTP/1.1\r\nHost: x\r\nContent-Type: image/png\r\nContent-Length: 999\r\n\r\n"
    )
    limits = {"POSE_MAX_REQUESTS": "4", "POSE_UPLOAD_TIMEOUT_S": "600"}
    with running_server(index_path, **limits) as running, ExitStack() as connections:
        host, port = running.url.removeprefix("http://").split(":")
        for _ in range(4):
            stalled = connections.enter_context(socket.create_connection((host, int(port))))
            stalled.sendall(head + b"\x89PNG")
        ask = partial(httpx.post, f"{running.url}/pose", files=photo.files)
        eventually(lambda: ask().status_code == 200)
        assert value(running, "pose_rejected_total", reason="slow_upload") >= 1


def test_the_server_answers_bytes_that_are_no_request(server: Server) -> None:
    host, port = server.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall(b"BREW /pot HTTP/1.1\r\n\r\n")
        answer = connection.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 501 ")
    assert b"application/problem+json" in answer
