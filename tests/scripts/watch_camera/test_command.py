"""A camera's client against services and streams that fail."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from urllib.parse import parse_qs, urlsplit

import cv2
import httpx
import numpy as np
import pytest

from app.video.frames import UnreadableError
from scripts.watch_camera import command
from scripts.watch_camera import service as service_module
from scripts.watch_camera import source as source_module
from tests.conftest import WALKERS, Server
from tests.support.videos import numbered_frames, write_video

EVENT = {"event": "entered", "state": "instant", "track_id": 3, "timestamp": 1e9, "zones": []}
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

    def do_GET(self) -> None:
        lost = EVENT | {"event": "fell", "timestamp": 9e9}
        listed = {"events": [EVENT, lost]} if self.path.endswith("/events") else {"zones": []}
        self._answer(200, listed)

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
    monkeypatch.setattr(service_module, "RETRY_AFTER_S", 0.0)
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
    return command.main(arguments)


def test_events_are_printed_as_json(
    service: str, video: str, capsys: pytest.CaptureFixture[str]
) -> None:
    began = time.time()
    assert run(video, "yard 2", "--url", f"{service}/prefix") == 0
    frames = [path for what, path in Service.seen if what == "POST 200"]
    assert {urlsplit(path).path for path in frames} == {"/prefix/cameras/yard%202/frames"}
    times = [float(parse_qs(urlsplit(path).query)["timestamp"][0]) for path in frames]
    assert times == sorted(set(times))
    assert times[0] == pytest.approx(began, abs=60)
    printed = capsys.readouterr()
    (event,) = map(json.loads, printed.out.splitlines())  # The same event in each answer.
    assert event.items() >= EVENT.items()
    assert (event["camera_id"], event["time"]) == ("yard 2", "2001-09-09T01:46:40.000+00:00")
    assert f"the end: {len(frames)} frames" in printed.err


def test_a_service_that_is_busy_restarted_or_ahead_is_asked_again(
    service: str, video: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Service.statuses = [503, 0, 409]
    assert run(video, "yard", "--url", service, "--fps", "1000") == 0
    assert [what for what, _ in Service.seen[:3]] == ["POST 503", "POST 409", "POST 200"]
    printed = capsys.readouterr()
    assert "status 503; trying again" in printed.err
    assert "the service does not answer" in printed.err
    # What happened since the first frame without an answer is asked for.
    assert Service.seen[3] == ("GET 200", "/cameras/yard/events")
    assert "fell" in [json.loads(line)["event"] for line in printed.out.splitlines()]


@pytest.mark.parametrize("option", ["--webhook=ftp://hook", "--mqtt=http://broker"])
def test_other_receivers_are_refused(option: str, video: str, capsys: Any) -> None:
    with pytest.raises(SystemExit):
        run(video, "yard", option)
    assert "expected" in capsys.readouterr().err


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

    def open(self, *_: object) -> Stream:
        return self

    def frames(self) -> Iterator[SimpleNamespace]:
        for _ in range(self._lengths.pop(0)):
            yield SimpleNamespace(timestamp=0.0, pixels=np.zeros((4, 4, 3), np.uint8))
        if not self._lengths:
            self._silent.set()
            threading.Event().wait()
        raise UnreadableError("a broken one")

    def close(self) -> None:
        pass


def test_a_lost_stream_is_opened_again_and_late_frames_are_dropped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    silent = threading.Event()
    monkeypatch.setattr(source_module, "RECONNECT_AFTER_S", (0.0,))
    monkeypatch.setattr(source_module, "Video", Stream([3, 0, 2], silent).open)
    source = source_module.Source("rtsp://user:secret@camera/1")
    assert silent.wait(10)
    assert next(source.frames()).number == 4
    said = capsys.readouterr().err
    assert "rtsp://camera/1 gives no frame" in said and "secret" not in said


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
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kept = httpx.get(f"{server.url}/cameras/walkers/events").json()["events"]
    assert [event["event"] for event in printed] == [event["event"] for event in kept]
    assert "entered" in {event["event"] for event in printed}
