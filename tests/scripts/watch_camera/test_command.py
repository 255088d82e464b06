"""A camera's client against services and streams that fail."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar
from urllib.parse import parse_qs, urlsplit

import cv2
import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from scripts.examples import watch_camera
from tests.conftest import WALKERS, Server
from tests.support.videos import numbered_frames, write_video

EVENT = {"event": "fell", "state": "begin", "track_id": 3, "timestamp": 0.2, "probability": 0.9}
ANSWER = {"persons": [], "events": [EVENT], "reset": None, "timings_ms": {"total": 9.0}}


class Service(BaseHTTPRequestHandler):
    """Answers frames with the next of ``statuses``, 200 once there are none left."""

    statuses: ClassVar[list[int]] = []
    seen: ClassVar[list[tuple[str, str]]] = []

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        assert cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR) is not None
        status = self.statuses.pop(0) if self.statuses else 200
        if status == 0:
            self.close_connection = True
            return
        self._answer(status, ANSWER if status == 200 else {"detail": f"status {status}"})

    def do_DELETE(self) -> None:
        self._answer(204, None)

    def _answer(self, status: int, content: object) -> None:
        self.seen.append((f"{self.command} {status}", self.path))
        body = b"" if content is None else json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("X-Session", "new" if len(self.seen) == 1 else "warm")
        self.send_header("Retry-After", "0")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setattr(watch_camera, "RETRY_AFTER_S", 0.0)
    Service.statuses, Service.seen = [], []
    with ThreadingHTTPServer(("127.0.0.1", 0), Service) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def video(tmp_path: Path) -> str:
    write_video(tmp_path / "yard.avi", numbered_frames(8))
    return str(tmp_path / "yard.avi")


def run(*arguments: str) -> int:
    return watch_camera.main(arguments)


def test_events_are_printed_and_the_camera_is_forgotten(
    service: str, video: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(video, "yard 2", "--url", f"{service}/prefix") == 0
    frames, last = Service.seen[:-1], Service.seen[-1]
    times = [float(parse_qs(urlsplit(path).query)["timestamp"][0]) for _, path in frames]
    assert times == sorted(set(times))
    assert last == ("DELETE 204", "/prefix/cameras/yard%202")
    printed = capsys.readouterr().out
    assert "person 3: fell begin at 0.2 s (90%)" in printed
    assert f"the end: {len(frames)} frames" in printed


def test_a_service_that_is_busy_restarted_or_older_is_asked_again(
    service: str, video: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Service.statuses = [503, 0, 409]
    assert run(video, "yard", "--url", service, "--fps", "1000") == 0
    assert [what for what, _ in Service.seen[:4]] == [
        "POST 503",
        "POST 409",
        "DELETE 204",
        "POST 200",
    ]
    printed = capsys.readouterr().out
    assert "status 503; trying again" in printed
    assert "the service does not answer" in printed


def test_what_does_not_pass_ends_it(
    service: str, video: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Service.statuses = [401]
    assert run(video, "yard", "--url", service) == 1
    assert "status 401" in capsys.readouterr().err


def test_a_missing_file_is_no_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit):
        run("missing.avi", "yard")


class Stream:
    """A stream that breaks after each of some numbers of frames, and then is silent."""

    def __init__(self, lengths: list[int], silent: threading.Event) -> None:
        self._lengths, self._silent = lengths, silent
        self._left = 0

    def open(self, *_: object) -> Stream:
        self._left = self._lengths.pop(0)
        return self

    def get(self, _: int) -> float:
        return 0.0

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        if not self._left and not self._lengths:
            self._silent.set()
            threading.Event().wait()
        self._left -= 1
        return self._left >= 0, np.zeros((4, 4, 3), np.uint8)

    def release(self) -> None:
        pass


def test_a_lost_stream_is_opened_again_and_late_frames_are_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    silent = threading.Event()
    monkeypatch.setattr(watch_camera, "RECONNECT_AFTER_S", (0.0,))
    monkeypatch.setattr(watch_camera.cv2, "VideoCapture", Stream([3, 0, 2], silent).open)
    source = watch_camera.Source("rtsp://camera")
    assert silent.wait(10)
    assert next(source.frames()).number == 4


def test_a_real_service_follows_a_file(
    server: Server,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    frame = np.asarray(cv2.imread(str(WALKERS)), np.uint8)
    write_video(tmp_path / "walkers.avi", [frame] * 12)
    source = str(tmp_path / "walkers.avi")
    assert run(source, "walkers", "--url", server.url) == 0
    assert "entered instant" in capsys.readouterr().out
    assert httpx.get(f"{server.url}/cameras/walkers").status_code == 404
