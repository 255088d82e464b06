"""A stream, a service, a broker and the bridge between them, which die one after the other.

The disk is a file system of 64 KiB where this may mount one, else a limit on the size of files.
"""

import json
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import IO, Any

import cv2
import httpx
import pytest

from tests.app.bridge.servers import Webhook, serving
from tests.conftest import ROOT, start_server, wait_until
from tests.golden.pictures import EMPTY_YARD, decode, walk
from tests.support.broker import MOSQUITTO, Broker, Subscriber
from tests.support.ports import free_ports
from tests.support.programs import none_left_running, run
from tests.support.service import eventually

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not MOSQUITTO, reason="needs mosquitto: apt-get install mosquitto"),
]

SEED = 54
KILLS = 20
OFFLINE_WITHIN_S = 20
BASE = "silhouette-pose/yard"
ZONES = [
    {"name": name, "kind": "watch", "polygon": [[x, 0], [x + 160, 0], [x + 160, 330], [x, 330]]}
    for name, x in (("gate", 0), ("path", 100))
]


class Stream:
    """Motion JPEG over HTTP: a walker crosses the yard, again and again."""

    def __init__(self) -> None:
        (self.port,) = free_ports(1)
        pictures = [frame for frame, _ in walk(20)] + [decode(EMPTY_YARD)] * 15
        self._frames = [cv2.imencode(".jpg", picture)[1].tobytes() for picture in pictures]
        self.start()

    def start(self) -> None:
        frames, self._ends = self._frames, threading.Event()
        ends = self._ends

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                with suppress(OSError):
                    while not ends.wait(0.1):
                        frame = frames[int(time.monotonic() * 5) % len(frames)]
                        head = f"Content-Type: image/jpeg\r\nContent-Length: {len(frame)}"
                        self.wfile.write(f"--frame\r\n{head}\r\n\r\n".encode() + frame + b"\r\n")

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", self.port), Handler)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        self._ends.set()
        self._server.shutdown()
        self._server.server_close()


class Service:
    """The service, and all events that it ever listed."""

    def __init__(self, index: Path, cameras: Path) -> None:
        self._index, self._port = index, str(free_ports(1)[0])
        self._cameras = str(cameras)
        cameras.write_text(json.dumps({"yard": {"zones": ZONES}}))
        self.url, self.listed = f"http://127.0.0.1:{self._port}", dict[str, dict[str, Any]]()
        self.start()
        threading.Thread(target=self._read, daemon=True).start()

    def start(self) -> None:
        self.process = start_server(
            self._index, PORT=self._port, POSE_CAMERAS_FILE=self._cameras, POSE_LOG_LEVEL="warning"
        ).process
        wait_until(f"{self.url}/readyz", timeout_s=120)

    def stop(self, number: int) -> None:
        end(self.process, number)

    def pause(self) -> None:
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self.process.send_signal(signal.SIGCONT)

    @property
    def frames(self) -> int:
        with suppress(httpx.HTTPError, KeyError):
            return int(httpx.get(f"{self.url}/cameras/yard").json()["frames"])
        return 0

    def _read(self) -> None:
        while True:
            with suppress(httpx.HTTPError, KeyError):
                for event in httpx.get(f"{self.url}/cameras/yard/events").json()["events"]:
                    self.listed[content(event)] = event
            time.sleep(0.2)


class Bridge:
    """The bridge, and all that it ever printed."""

    def __init__(self, *arguments: str) -> None:
        self._arguments = arguments
        self.events, self.log = list[str](), list[str]()
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "app.bridge", *self._arguments],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        for stream, lines in ((self.process.stdout, self.events), (self.process.stderr, self.log)):
            threading.Thread(target=self._read, args=(stream, lines), daemon=True).start()

    def stop(self, number: int) -> None:
        end(self.process, number)

    def logged(self, text: str) -> int:
        """Number of lines of the log with a text."""
        return sum(text in line for line in list(self.log))

    @staticmethod
    def _read(stream: IO[str], lines: list[str]) -> None:
        for line in stream:
            lines.append(line)


def end(process: subprocess.Popen[Any], number: int) -> None:
    """Send a process the signal that ends it."""
    process.send_signal(number)
    process.wait(timeout=30)


def content(event: dict[str, Any]) -> str:
    """What the service says of an event."""
    own = ("id", "camera_id", "time", "replay")
    return json.dumps({k: v for k, v in event.items() if k not in own}, sort_keys=True)


@pytest.fixture(autouse=True)
def _ended() -> Iterator[None]:
    """A failed run leaves no service, broker or bridge behind."""
    with none_left_running():
        yield


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A folder, which is a small file system if possible."""
    folder = tmp_path / "disk"
    folder.mkdir()
    is_small = run("mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder).returncode == 0
    yield folder
    if is_small:
        run("umount", "--lazy", folder)


@contextmanager
def full(disk: Path, process: subprocess.Popen[str]) -> Iterator[None]:
    """Leave a process no room on the disk."""
    if disk.is_mount():
        filler = disk / "filler"
        with suppress(OSError), filler.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(512))
        yield
        filler.unlink()
    else:
        limits = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (1, limits[1]))
        yield
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, limits)


class Receivers:
    """Home Assistant and a webhook."""

    def __init__(self, broker: Broker) -> None:
        self.home, self.hook = Subscriber(broker.port), Webhook()

    def show(self, since: float, within_s: float = 60, **topics: str) -> None:
        """Expect that these are soon the last payloads after a moment."""

        def are_shown() -> bool:
            last = {topic: text for moment, topic, text in self.home.history if moment > since}
            return all(last.get(f"{BASE}/{topic}") == text for topic, text in topics.items())

        eventually(are_shown, within_s)

    def have(self, listed: set[str]) -> bool:
        """Whether both have these events."""
        return all(listed <= set(map(content, got)) for got in (self.home.events, self.hook.got))


def test_every_event_arrives_and_blindness_is_shown(
    index_path: Path, tmp_path: Path, disk: Path
) -> None:
    rng = random.Random(SEED)
    stream, service = Stream(), Service(index_path, tmp_path / "cameras.json")
    broker = Broker(tmp_path, refused=(f"{BASE}/events",))
    receivers = Receivers(broker)
    with serving(receivers.hook) as webhook:
        bridge = Bridge(
            *(f"http://127.0.0.1:{stream.port}/", "yard", "--url", service.url),
            *("--mqtt", broker.address, "--webhook", f"http://{webhook}"),
            *("--queue", str(disk / "queue.db"), "--fps", "5"),
        )
        programs = {"broker": broker, "service": service, "bridge": bridge}

        # What the broker refuses waits.
        eventually(lambda: bridge.logged(f"refuses {BASE}/events: Not authorized"), 60)
        assert not receivers.home.events
        broker.refuse()
        eventually(lambda: receivers.home.events, 60)

        for _ in range(KILLS):
            time.sleep(rng.uniform(0, 3))
            victim, began = rng.choice(list(programs)), time.monotonic()
            programs[victim].stop(rng.choice([signal.SIGKILL, signal.SIGTERM]))
            time.sleep(rng.uniform(0, 2))
            programs[victim].start()
            # The next may be the service, with which goes what the bridge has not fetched.
            if victim == "service":
                eventually(lambda: service.frames, 60)
            else:
                receivers.show(began, available="online")

        # A full disk, while events wait for the broker.
        broker.stop(signal.SIGKILL)
        printed, faults = len(bridge.events), bridge.logged("queue: ")
        with full(disk, bridge.process):
            eventually(lambda: len(bridge.events) > printed + 2, 60)
            assert bridge.logged("queue: ") == faults + 1
        broker.start()
        eventually(lambda: bridge.logged("events are stored"), 60)

        # Blind: the service hangs, the stream ends, the bridge is gone.
        unknown = {"available": "offline", "people": "None"}
        for blind, restored, shown in (
            (service.pause, service.go_on, unknown),
            (stream.stop, stream.start, unknown),
            (partial(bridge.stop, signal.SIGKILL), bridge.start, {"available": "offline"}),
        ):
            receivers.show(0, available="online")
            began = time.monotonic()
            blind()
            receivers.show(began, OFFLINE_WITHIN_S, **shown)
            restored()
            receivers.show(began, available="online")

        stream.stop()
        time.sleep(3)
        listed = set(service.listed)
        assert len(listed) > KILLS / 2  # On a busy machine, few frames are answered.
        eventually(lambda: receivers.have(listed), 60)
        assert listed <= {content(json.loads(line)) for line in bridge.events}
        bridge.stop(signal.SIGTERM)
        assert bridge.process.returncode == 0
        assert not bridge.logged("Traceback")
    receivers.home.close()
    broker.stop()
    service.stop(signal.SIGTERM)
