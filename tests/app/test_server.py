"""The service as a process: start, probes, overload, hang-ups, the end."""

from __future__ import annotations

import json
import shutil
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from tests.conftest import Photo, Server, start_server, wait_until


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
    running = start_server(index_path, POSE_CONCURRENCY="1", POSE_MAX_WAIT_S="2")
    wait_until(f"{running.url}/readyz")
    yield running
    running.stop()


def metric(server: Server, line: str) -> float:
    for text in httpx.get(f"{server.url}/metrics").text.splitlines():
        if text.startswith(f"{line} "):
            return float(text.split()[-1])
    return 0.0


def test_a_frame_over_a_real_socket(server: Server, photo: Photo) -> None:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    answer = httpx.post(f"{server.url}/pose", files=files).json()
    assert answer["persons"][0]["hypotheses"][0]["entry"] == photo.entry


def test_overload_is_refused_at_once_and_probes_go_on(narrow: Server, slow_frame: bytes) -> None:
    def ask(_: int) -> tuple[int, float, str | None]:
        started = time.perf_counter()
        response = httpx.post(f"{narrow.url}/pose", files={"frame": slow_frame}, timeout=30)
        seconds = time.perf_counter() - started
        return response.status_code, seconds, response.headers.get("retry-after")

    ask(0)  # From now on it knows what such a frame takes.
    with ThreadPoolExecutor(20) as clients:
        answers = list(clients.map(ask, range(20)))
        # While the last ones are still worked on, nothing else waits for them.
    accepted = [seconds for status, seconds, _ in answers if status == 200]
    refused = [(seconds, after) for status, seconds, after in answers if status == 503]
    assert len(accepted) + len(refused) == 20
    assert accepted
    assert len(refused) >= 10
    assert all(int(after or 0) >= 1 for _, after in refused)
    assert np.median([seconds for seconds, _ in refused]) < max(accepted)
    assert metric(narrow, 'pose_rejected_total{reason="overloaded"}') == len(refused)


def test_frames_nobody_waits_for_are_dropped(narrow: Server, slow_frame: bytes) -> None:
    def ask_and_hang_up(_: int) -> None:
        with pytest.raises(httpx.ReadTimeout):
            httpx.post(f"{narrow.url}/pose", files={"frame": slow_frame}, timeout=0.06)

    with ThreadPoolExecutor(3) as clients:
        list(clients.map(ask_and_hang_up, range(3)))
    deadline = time.monotonic() + 10
    while metric(narrow, "pose_in_flight") > 0:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert metric(narrow, 'pose_rejected_total{reason="client_gone"}') >= 2
    # Two of the three never got further than the queue.
    assert metric(narrow, 'pose_stage_seconds_count{stage="total"}') <= 1


def test_sigterm_finishes_what_runs_and_what_waits_and_ends_with_status_0(
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
        while metric(running, "pose_in_flight") < 3 and not any(a.done() for a in answers):
            pass
        assert running.stop() == 0
        assert [answer.result() for answer in answers] == [200, 200, 200]


def assert_told_not_served(running: Server, expected: str) -> None:
    """Probe a server that cannot get ready, send it a frame, and stop it."""
    try:
        wait_until(f"{running.url}/healthz")
        deadline, detail = time.monotonic() + 10, ""
        while expected not in detail:
            assert time.monotonic() < deadline, detail
            response = httpx.get(f"{running.url}/readyz")
            assert response.status_code == 503
            detail = response.json()["detail"]
        response = httpx.post(f"{running.url}/pose", files={"frame": b"x"})
        assert response.status_code == 503
        assert response.headers["content-type"] == "application/problem+json"
    finally:
        assert running.stop() == 0


def test_a_corrupted_index_is_told_not_served(index_path: Path, tmp_path: Path) -> None:
    corrupted = tmp_path / "index"
    shutil.copytree(index_path, corrupted)
    vectors = corrupted / "descriptors.faiss.xz"
    vectors.write_bytes(vectors.read_bytes()[:-10])
    assert_told_not_served(start_server(corrupted), "truncated")


def test_a_slow_upload_is_sent_away(index_path: Path) -> None:
    running = start_server(index_path, POSE_UPLOAD_TIMEOUT_S="0.3")

    def trickle() -> Iterator[bytes]:
        yield b'--b\r\nContent-Disposition: form-data; name="frame"; filename="f"\r\n\r\n'
        for _ in range(20):
            yield b"x"
            time.sleep(0.1)

    try:
        wait_until(f"{running.url}/readyz")
        headers = {"content-type": "multipart/form-data; boundary=b"}
        response = httpx.post(f"{running.url}/pose", content=trickle(), headers=headers)
        assert response.status_code == 408
    except httpx.WriteError:
        pass  # The connection was closed while the client still wrote.
    finally:
        assert running.stop() == 0


def test_stalled_uploads_do_not_keep_others_out(index_path: Path, photo: Photo) -> None:
    running = start_server(index_path, POSE_MAX_REQUESTS="4", POSE_UPLOAD_TIMEOUT_S="600")
    host, port = running.url.removeprefix("http://").split(":")
    head = (
        b"POST /pose HTTP/1.1\r\nHost: x\r\nContent-Type: image/png\r\nContent-Length: 999\r\n\r\n"
    )
    try:
        wait_until(f"{running.url}/readyz")
        with ExitStack() as connections:
            for _ in range(4):
                stalled = connections.enter_context(socket.create_connection((host, int(port))))
                stalled.sendall(head + b"\x89PNG")
            files = {"frame": photo.frame_png, "mask": photo.mask_png}
            deadline, status = time.monotonic() + 20, 0
            while status != 200:
                assert time.monotonic() < deadline
                status = httpx.post(f"{running.url}/pose", files=files).status_code
                time.sleep(0.1)
        assert metric(running, 'pose_rejected_total{reason="slow_upload"}') >= 1
    finally:
        assert running.stop() == 0


def test_a_server_speaks_of_problems_where_there_is_no_request(server: Server) -> None:
    host, port = server.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall(b"BREW /pot HTTP/1.1\r\n\r\n")
        answer = connection.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 501 ")
    assert b"application/problem+json" in answer


def test_a_too_large_upload_is_told_so(index_path: Path) -> None:
    running = start_server(index_path, POSE_MAX_UPLOAD_BYTES="100000")
    try:
        wait_until(f"{running.url}/readyz")
        response = httpx.post(f"{running.url}/pose", files={"frame": b"x" * 3_000_000})
        assert response.status_code == 413
    finally:
        assert running.stop() == 0
