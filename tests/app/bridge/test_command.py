"""The bridge against services and streams that fail, and command lines that cannot be followed."""

from __future__ import annotations

import base64
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import app.bridge as common_module
from app.bridge import bridge as bridge_module
from app.bridge import source as source_module
from app.bridge.__main__ import run
from app.bridge.outbox import Outbox
from app.decoding import Frame
from app.decoding.videos import VideoError
from tests.app.bridge.cameras import MjpegCamera, RtspCamera
from tests.app.bridge.servers import Service, Webhook, event, full_disk, serving
from tests.conftest import HTTP, ROOT, Server
from tests.golden.pictures import EMPTY_YARD, STREET, STREET_MASK, WALKER, decode
from tests.support.programs import children
from tests.support.videos import noisy_frames, numbered_frames, write_video

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_module, "RETRY_AFTER_S", 0.0)
    monkeypatch.setattr(common_module, "WAITS_S", (0.05,))
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # Those of pytest stay.


@pytest.fixture
def video(tmp_path: Path) -> str:
    write_video(tmp_path / "yard.avi", numbered_frames(8), fps=20)
    return str(tmp_path / "yard.avi")


@pytest.fixture
def watch(video: str, capsys: Capture) -> Callable[..., tuple[int, list[dict[str, Any]], str]]:
    """Watch the video with a service; return the status, the events printed, and the log."""

    def _watch(service: Service, *options: str | Path) -> tuple[int, list[dict[str, Any]], str]:
        with serving(service) as host:
            url = ("--url", f"http://{host}", "--fps", "1000")
            ended = run([video, "yard", *url, *map(str, options)])
        printed = capsys.readouterr()
        return ended, [json.loads(line) for line in printed.out.splitlines()], printed.err

    return _watch


def names(events: list[dict[str, Any]]) -> list[str]:
    return [event["event"] for event in events]


def test_events_are_printed_as_json(watch: Any) -> None:
    began, service = time.time(), Service("entered")
    ended, (printed,), log = watch(service)
    assert ended == 0
    frames = [path for what, path in service.seen if what == "POST 200"]
    assert {urlsplit(path).path for path in frames} == {"/cameras/yard/frames"}
    times = [float(parse_qs(urlsplit(path).query)["timestamp"][0]) for path in frames]
    assert times == sorted(set(times))
    assert times[0] == pytest.approx(began, abs=60)
    assert printed.items() >= event("entered", 1e9).items()
    assert (printed["camera_id"], printed["time"]) == ("yard", "2001-09-09T01:46:40.000+00:00")
    assert f"the end: {len(frames)} frames" in log


@pytest.mark.parametrize("status", [0, 400, 409, 413, 500, 503])
def test_a_frame_that_is_not_taken_is_skipped(status: int, watch: Any) -> None:
    service = Service("entered", "fell")
    service.statuses = [200, status]
    ended, printed, log = watch(service)
    assert ended == 0
    assert names(printed) == ["entered", "fell"]  # The latter is listed if its answer was lost.
    assert log.count("the service answers again") == 1
    assert f"status {status}" in log or "the service does not answer" in log


@pytest.mark.parametrize(
    ("statuses", "ended"),
    [([401], 1), ([200, 401], 1), ([200, 403], 1), ([404], 1), ([422], 1), ([200, 404, 422], 0)],
)
def test_only_keys_and_a_refused_set_up_end_it(statuses: list[int], ended: int, watch: Any) -> None:
    service = Service()
    service.statuses = list(statuses)
    status, _, log = watch(service)
    assert status == ended
    assert (f"the service refuses: status {statuses[-1]}" in log) == bool(ended)


def test_what_the_service_lists_is_not_lost_at_a_stop(watch: Any, tmp_path: Path) -> None:
    queue, service = ("--queue", tmp_path / "yard.db"), Service()
    service.listed = [event("lying", 5e8)]  # From before the first start.
    assert names(watch(service, *queue)[1]) == []
    service.events = [event("entered", 1e9)]
    assert names(watch(service, *queue)[1]) == ["entered"]
    service.listed += [event("fell", 2e9), event("left", 2e9)]  # In flight when it was stopped.
    printed = watch(service, *queue)[1]
    assert names(printed) == ["fell", "left"]
    assert names(watch(service, *queue)[1]) == []
    # An event always has the same id, and cameras do not share a position.
    (tmp_path / "yard.db").unlink()
    Outbox("yard", [], tmp_path / "yard.db").begin_after("")
    Outbox("hall", [], tmp_path / "yard.db").begin_after(printed[-1]["id"])
    again = watch(service, *queue)[1]
    assert [seen["id"] for seen in again][-2:] == [seen["id"] for seen in printed]


def test_a_full_disk_loses_no_event(watch: Any, tmp_path: Path) -> None:
    Outbox("yard", [], tmp_path / "yard.db")
    webhook = Webhook()
    with serving(webhook) as host, full_disk():
        options = ("--queue", tmp_path / "yard.db", "--webhook", f"http://{host}")
        ended, printed, log = watch(Service("entered", "fell"), *options)
    assert ended == 0
    assert printed == webhook.got
    assert names(printed) == ["entered", "fell"]
    (line,) = [line for line in log.splitlines() if "queue: " in line]
    assert "events wait in memory" in line


def test_who_was_there_when_the_service_ended_has_left(watch: Any) -> None:
    service = Service("entered")
    service.sessions = ["new", "warm", "warm", "new"]
    _, printed, log = watch(service)
    assert names(printed) == ["entered", "left"]
    assert "the service had forgotten this camera" in log
    assert printed[1]["track_id"] == printed[0]["track_id"]
    assert printed[1].keys() == printed[0].keys()


def test_credentials_of_addresses_are_used(watch: Any) -> None:
    webhook, service = Webhook(), Service("entered")
    with serving(webhook) as host:
        watch(service, "--webhook", f"http://me:p%40ss@{host}/hook?x=1", "--api-key", "first")
    assert webhook.seen == [("POST 204", "/hook?x=1")]
    encoded = webhook.headers[0]["Authorization"].removeprefix("Basic ")
    assert base64.b64decode(encoded) == b"me:p@ss"
    assert {headers["X-API-Key"] for headers in service.headers} == {"first"}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("0", "yard", "--fps=fast"), "--fps: expected a number, got 'fast'"),
        (("0", "yard", "--queue=/nope/x.db"), "queue: expected a file for events, got /nope/x.db"),
        (("0", "yard", "--url=127.0.0.1:8000"), "--url: expected http://HOST[:PORT] or https://"),
        (("0", "yard", "--webhook=http://u:s3cret@host:abc/"), "--webhook: expected http://HOST"),
        (("0", "yard", "--webhook=http://u:s3cret@host/ /"), "--webhook: expected http://HOST[:"),
        (("0", "yard", "--mqtt=http://u:s3cret@broker"), "--mqtt: expected mqtt://HOST[:PORT] or"),
        (("u:s3cret@host/x", "yard"), "source: expected a file, a number or a URL, got host/x"),
        (("-", "yard"), "source: expected a file, a number or a URL, got nothing"),
        (("0", "back yard"), "camera_id: expected text of the form"),
        (("0", "--fps=2"), "expected a camera_id, or no --fps beside a file of cameras"),
        (("nope.yaml",), "expected a file of cameras, got nope.yaml: No such file or directory"),
    ],
)
def test_what_cannot_be_followed_is_one_sentence(
    arguments: tuple[str, ...], expected: str, capsys: Capture
) -> None:
    assert failure(*arguments, capsys=capsys).count(expected) == 1


def failure(*arguments: str, capsys: Capture) -> str:
    """What the program reports when it cannot do as it is told."""
    try:
        status = run(arguments)
    except SystemExit as ended:
        status = ended.code
    assert status in (1, 2)
    printed = capsys.readouterr().err
    assert "Traceback" not in printed
    assert "s3cret" not in printed
    return printed


def test_a_stop_is_clean_and_shows_no_password(tmp_path: Path) -> None:
    # Every third run aborted: a thread came back from the decoder to a Python that was ending.
    write_video(tmp_path / "long.avi", noisy_frames(200), fps=100)
    secret = "s3cret"
    address = f"//admin:{secret}@127.0.0.1:1/{secret}"
    command = [
        *(sys.executable, "-m", "app.bridge", "-", "yard", "--url", f"http:{address}"),
        *("--webhook", f"http:{address}", "--mqtt", f"mqtt:{address}", "--api-key", secret),
    ]
    for source in [str(tmp_path / "long.avi")] * 2 + [f"rtsp:{address}"]:
        process = subprocess.Popen(
            command, cwd=ROOT, env={**os.environ, "WATCH_SOURCE": source},
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stderr is not None
        expected = "the source gives no frame" if "//" in source[:7] else "does not answer"
        log = ""
        while expected not in log:
            line = process.stderr.readline()
            assert line, log
            log += line
        process.terminate()
        log += process.communicate(timeout=60)[1]
        assert process.returncode == 0, log
        assert secret not in log


def test_the_time_of_day_follows_a_clock_that_was_set(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(source_module.Source, "_read", lambda self: None)
    source, shift_s = source_module.Source("0"), 0.0
    clock = time.time
    monkeypatch.setattr(source_module.time, "time", lambda: clock() + shift_s)
    for shift_s, is_said in ((1.0, False), (90_000.0, True), (90_002.0, False), (5.0, True)):
        expected = clock() + shift_s
        assert source._time_of_day(time.monotonic()) == pytest.approx(expected, abs=3)
        assert ("the clock of this machine was set by" in capsys.readouterr().err) == is_said


class Shown:
    """Videos given by the times of their frames, which break; the last is then silent."""

    def __init__(self, *videos: list[float]) -> None:
        self._videos = [*videos]
        self.silent = threading.Event()

    def open(self, *_: object, **__: object) -> Shown:
        return self

    def frames(self) -> Iterator[Frame]:
        for time_s in self._videos.pop(0):
            yield Frame(0, time_s, np.zeros((4, 4, 3), np.uint8))
        if not self._videos:
            self.silent.set()
            threading.Event().wait()
        raise VideoError("undecodable", "a broken one")

    def close(self) -> str:
        return ""


def test_a_recording_plays_on_where_its_time_jumps(
    video: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(source_module, "Decoder", Shown([0.0, 0.1, 5000.0, 5000.1], []).open)
    source = source_module.Source(video)
    with source._changed:
        assert source._changed.wait_for(lambda: source._ended, 60)
    assert source._number == 4
    assert capsys.readouterr().err.count("a broken one") == 1


def test_a_lost_stream_is_opened_again_and_late_frames_are_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = Shown([0.0] * 3, [], [0.0] * 2)
    monkeypatch.setattr(source_module, "Decoder", shown.open)
    source = source_module.Source("rtsp://camera")
    assert shown.silent.wait(60)
    assert next(source.frames(threading.Event())).number == 4


@pytest.mark.skipif(sys.platform != "linux", reason="needs seccomp")
@pytest.mark.parametrize("kind", ["rtsp", "http", "file"])
def test_what_decodes_a_source_is_confined_and_holds_no_password_of_a_receiver(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCH_MQTT", "mqtt://user:s3cret@broker")
    camera = {"rtsp": RtspCamera, "http": MjpegCamera}.get(kind)
    if camera is None:
        write_video(tmp_path / "long.avi", noisy_frames(20), fps=1)
    with ExitStack() as stack:
        address = stack.enter_context(camera()) if camera else str(tmp_path / "long.avi")
        source = stack.enter_context(closing(source_module.Source(address)))
        assert next(source.frames(threading.Event())).pixels.shape == (240, 320, 3)
        processes = [Path(f"/proc/{number}") for number in children()]
        decoders = [
            process
            for process in processes
            if b"app.decoding.video_program" in (process / "cmdline").read_bytes()
        ]
        assert decoders
        for process in decoders:
            assert "Seccomp:\t2" in (process / "status").read_text()
            for known in ("environ", "cmdline"):
                assert b"s3cret" not in (process / known).read_bytes()
                assert b"pass" not in (process / known).read_bytes()


def falling_walker() -> Iterator[NDArray[np.uint8]]:
    """A walker, cut out of a photograph, stands and then falls over: six frames a second."""
    yard, walkers = decode(EMPTY_YARD), decode(STREET)
    mask = np.float32(decode(STREET_MASK) == WALKER)
    for number in range(27):
        degrees = 90 * np.clip((number - 9) / 4, 0, 1)
        # About the feet, which are then put on the middle of the yard.
        turn = cv2.getRotationMatrix2D((154, 266), -degrees, 1.5)
        turn[:, 2] += (0, 20)
        size = yard.shape[1::-1]
        walker, alpha = cv2.warpAffine(walkers, turn, size), cv2.warpAffine(mask, turn, size)
        yield np.where(alpha[..., None] > 0.5, walker, yard)


def test_a_fall_on_film_is_detected_by_a_real_service(
    server: Server, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However slow the machine: a frame waits until the one before it was taken."""
    time_of_day = source_module.Source._time_of_day

    def taken(source: source_module.Source, moment: float) -> float:
        while source._newest is not None:
            source._changed.wait(0.01)
        return time_of_day(source, moment)

    monkeypatch.setattr(source_module.Source, "_time_of_day", taken)
    write_video(tmp_path / "yard.avi", list(falling_walker()), fps=6)
    assert run([str(tmp_path / "yard.avi"), "yard", "--url", server.url]) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kept = HTTP.get(f"{server.url}/cameras/yard/events").json()["events"]
    assert HTTP.delete(f"{server.url}/cameras/yard").status_code == 204
    assert names(printed) == names(kept)
    assert names(printed)[0] == "entered"
    assert sorted(names(printed)[1:]) == ["fell", "lying"]
