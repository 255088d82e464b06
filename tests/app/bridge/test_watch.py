"""Several cameras in one bridge: each on its own, changed while others go on."""

import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

import app.bridge as common
from app.bridge import watch as watch_module
from app.bridge.__main__ import run
from app.bridge.bridge import Bridge
from tests.app.bridge.cameras import MjpegCamera
from tests.app.bridge.servers import Service, event, serving
from tests.support.broker import MOSQUITTO, Broker, Subscriber
from tests.support.service import eventually

Log = pytest.CaptureFixture[str]


class Cameras(Service):
    """A service of several cameras; it has none of some names."""

    def __init__(self, *unknown: str) -> None:
        super().__init__()
        self._unknown = unknown
        self.frames: dict[str, int] = {}
        self.configured: list[tuple[str, Any]] = []

    def answer(self, method: str, path: str, body: bytes) -> tuple[int, Any]:
        name = path.split("/")[2]
        if name in self._unknown:
            return 404, {"detail": "no such camera"}
        if method == "PUT":
            self.configured.append((name, json.loads(body)))
            return 200, {"zones": []}
        if method == "POST":
            self.frames[name] = self.frames.get(name, 0) + 1
        return super().answer(method, path, body)


class Running:
    """A bridge of a file, in a thread."""

    def __init__(self, file: Path, service: Cameras, url: str) -> None:
        self.service, self._file, self._url = service, file, url
        self._signals = list[int]()
        self._thread = threading.Thread(target=run, args=([str(file)], self._signals))

    def says(self, cameras: dict[str, Any], **shared: Any) -> None:
        """Write the file; it is read anew if the bridge runs."""
        self._file.write_text(json.dumps({"url": self._url, "cameras": cameras, **shared}))
        if self._thread.is_alive():
            self._signals.append(signal.SIGHUP)
            eventually(lambda: not self._signals)
        else:
            self._thread.start()

    def go_on(self, *names: str) -> None:
        """Expect further frames of cameras."""
        before = dict(self.service.frames)
        eventually(lambda: all(self.service.frames.get(n, 0) > before.get(n, 0) + 1 for n in names))

    def end(self) -> None:
        self._signals.append(signal.SIGTERM)
        self._thread.join(60)
        assert not self._thread.is_alive()


@pytest.fixture
def bridge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Running]]:
    monkeypatch.setattr(common, "WAITS_S", (0.05,))
    with ExitStack() as stack:

        def _bridge(*unknown: str) -> Running:
            service = Cameras(*unknown)
            url = f"http://{stack.enter_context(serving(service))}"
            running = Running(tmp_path / "cameras.yaml", service, url)
            stack.callback(running.end)
            return running

        yield _bridge


def test_a_camera_that_fails_touches_no_other(
    bridge: Callable[..., Running], capfd: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch, faults = Bridge.watch, []

    def faulty(self: Bridge, *arguments: Any) -> None:
        if threading.current_thread().name == "faulty" and not faults:
            faults.append(1)
            raise RuntimeError("a mistake")
        watch(self, *arguments)

    monkeypatch.setattr(Bridge, "watch", faulty)
    monkeypatch.setattr(watch_module, "_FAULT_WAIT_S", 0.1)
    running = bridge("refused")
    with MjpegCamera() as live:
        sources = {"dead": "rtsp://127.0.0.1:1/x", "yard": live, "refused": live, "faulty": live}
        running.says({name: {"source": source} for name, source in sources.items()})
        running.go_on("yard", "faulty")
        running.go_on("yard", "faulty")
    assert running.service.frames.keys() == {"yard", "faulty"}
    log = capfd.readouterr().err
    assert log.count("dead: the source gives no frame; trying again") == 1
    assert log.count("refused: the service does not take a frame: no such camera (404)") == 1
    assert log.count("faulty: a fault of this program: RuntimeError: a mistake") == 1


def test_only_what_changed_begins_anew(bridge: Callable[..., Running], capfd: Log) -> None:
    running, zone = bridge(), {"name": "bed", "kind": "rest", "polygon": [[0, 0], [9, 0], [9, 9]]}
    with MjpegCamera() as live:
        cameras: dict[str, Any] = {
            "yard": {"source": live},
            "hall": {"source": live, "zones": [zone]},
            "attic": {"source": live},
        }
        running.says(cameras)
        running.go_on("yard", "hall", "attic")
        (configured,) = running.service.configured
        assert configured[0] == "hall" and configured[1]["zones"][0]["name"] == "bed"
        running.says({"yard": cameras["yard"], "hall": {"source": live}, "den": {"source": live}})
        running.go_on("yard", "hall", "den")
        before = running.service.frames["attic"]
        assert running.service.configured[1:] == [("hall", {})]
        running.says({"yard": {"source": "gone.avi"}})
        running.go_on("yard", "hall", "den")
        assert running.service.frames["attic"] == before
    log = capfd.readouterr().err
    ends = {line.split()[1] for line in log.splitlines() if "the end:" in line}
    assert ends == {"hall:", "attic:"}
    (line,) = [line for line in log.splitlines() if "stay as they are" in line]
    assert "line 1: cameras.yard.source: expected a file, a number or a URL" in line


def test_events_that_wait_outlive_a_change(bridge: Callable[..., Running]) -> None:
    running, hook = bridge(), Cameras()
    with MjpegCamera() as live, serving(hook) as host:
        hook.statuses = [503] * 1000
        running.service.events = [event("fell", 1e9)]
        options = {"webhook": f"http://{host}/hooks/1"}
        running.says({"yard": {"source": live}}, **options)
        eventually(lambda: hook.seen)
        running.says({"yard": {"source": live, "fps": 5}}, **options)
        hook.statuses.clear()
        eventually(lambda: any(what == "POST 200" for what, _ in hook.seen))


@pytest.mark.skipif(not MOSQUITTO, reason="needs mosquitto: apt-get install mosquitto")
def test_a_camera_that_left_the_file_is_removed_from_home_assistant(
    bridge: Callable[..., Running], tmp_path: Path, capfd: Log
) -> None:
    broker = Broker(tmp_path)
    home = Subscriber(broker.port)

    def devices() -> set[str]:
        kept = [topic for topic, payload in home.latest.items() if payload]
        return {
            topic.split("/")[2] if "/config" in topic else topic.split("/")[1] for topic in kept
        }

    shared = {"mqtt": broker.address, "queue": str(tmp_path / "queue.db")}
    with MjpegCamera() as live:
        running = bridge()
        running.says({"yard": {"source": live}, "hall": {"source": live}}, **shared)
        running.go_on("yard", "hall")
        both = {"yard", "hall", "silhouette_pose_yard", "silhouette_pose_hall"}
        eventually(lambda: devices() == both)
        running.says({"yard": {"source": live}}, **shared)
        eventually(lambda: devices() == {"yard", "silhouette_pose_yard"})
        eventually(lambda: "hall: the camera is removed" in capfd.readouterr().err)
        running.end()
        running = bridge()  # While it did not run, the file changed again.
        running.says({"den": {"source": live}}, **shared)
        eventually(lambda: devices() == {"den", "silhouette_pose_den"})
        time.sleep(0.5)
        assert devices() == {"den", "silhouette_pose_den"}
    home.close()
    broker.stop()
