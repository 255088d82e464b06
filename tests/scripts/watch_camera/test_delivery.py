"""Events over a real broker and to a real webhook, both restarted on the way."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from scripts.watch_camera import outbox as outbox_module
from scripts.watch_camera.command import Bridge
from scripts.watch_camera.outbox import Outbox, deliver
from scripts.watch_camera.service import Camera
from scripts.watch_camera.source import Frame
from scripts.watch_camera.webhook import Webhook
from tests.conftest import ROOT, running_server
from tests.support.broker import MOSQUITTO, Broker
from tests.support.ports import free_ports
from tests.support.service import eventually

mqtt = pytest.importorskip("paho.mqtt.client", reason="needs paho-mqtt")
pytestmark = pytest.mark.skipif(not MOSQUITTO, reason="needs mosquitto: apt-get install mosquitto")

FALL = ROOT.parent / "shared" / "real" / "upfall" / "activity1_trial1_cam1.mp4"
FLOOR = {
    "name": "the floor",
    "kind": "watch",
    "polygon": [[0, 0], [2000, 0], [2000, 2000], [0, 2000]],
}


class WebhookServer:
    """Collects what is posted to it."""

    def __init__(self) -> None:
        (self.port,) = free_ports(1)
        self.got: list[dict[str, Any]] = []
        self.start()

    def start(self) -> None:
        got = self.got

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                event = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                assert self.headers["Idempotency-Key"] == event["id"]
                got.append(event)
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", self.port), Handler)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class Subscriber:
    """A receiver whose session the broker keeps while it is away."""

    def __init__(self, port: int) -> None:
        self.events: list[dict[str, Any]] = []
        self.retained: dict[str, str] = {}
        self._client = mqtt.Client(
            mqtt.CallbackAPIVersion.VERSION2, client_id="home", clean_session=False
        )
        self._client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        self._client.on_message = self._take
        self._client.reconnect_delay_set(1, 1)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        eventually(self._client.is_connected)

    def _take(self, _client: Any, _data: Any, message: Any) -> None:
        if message.topic.endswith("/events"):
            self.events.append(json.loads(message.payload))
        else:
            self.retained[message.topic] = message.payload.decode()

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Film:
    """Every fifth frame of a film; some actions come before some of them."""

    def __init__(self, path: Path, actions: dict[int, Callable[[], None]]) -> None:
        self._path, self._actions = path, actions

    def frames(self) -> Iterator[Frame]:
        capture = cv2.VideoCapture(str(self._path))
        step = max(1, round(capture.get(cv2.CAP_PROP_FPS) / 5))
        total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        done: set[int] = set()
        for number in range(total):
            read, pixels = capture.read()
            if not read:
                return
            for tenth in set(self._actions) - done:
                if number >= tenth * total / 10:
                    done.add(tenth)
                    self._actions[tenth]()
            if number % step == 0:
                yield Frame(number, 1e9 + number / step / 5, np.asarray(pixels, np.uint8))


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox_module, "RETRY_AFTER_S", (0.1,))


@pytest.mark.skipif(not FALL.exists(), reason="needs ../shared")
def test_every_event_of_a_fall_arrives_once_at_each_receiver(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from scripts.watch_camera.home_assistant import HomeAssistant

    broker, webhook = Broker(tmp_path), WebhookServer()
    subscriber = Subscriber(broker.port)
    home = HomeAssistant(f"mqtt://127.0.0.1:{broker.port}", "ward.1")
    outbox, stopping = Outbox(tmp_path / "queue.db"), threading.Event()
    senders = {
        "webhook": Webhook(f"http://127.0.0.1:{webhook.port}/hook?x=1").send,
        "mqtt": home.send,
    }
    for receiver, send in senders.items():
        work = (outbox, receiver, send, stopping)
        threading.Thread(target=deliver, args=work, daemon=True).start()
    with running_server(None) as server:
        httpx.put(f"{server.url}/cameras/ward.1", json={"zones": [FLOOR]}).raise_for_status()
        bridge = Bridge(Camera(server.url, "ward.1", None), outbox, tuple(senders), home)
        actions = {1: broker.stop, 2: webhook.stop, 7: broker.start, 8: webhook.start}
        bridge.watch(Film(FALL, actions), fps=1000)  # type: ignore[arg-type]
        recognised = httpx.get(f"{server.url}/cameras/ward.1/events").json()["events"]
    assert outbox.wait_until_empty(60)
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {"entered", "zone_entered", "fell"} <= {event["event"] for event in printed}
    own = ("id", "camera_id", "time")
    assert [{k: v for k, v in event.items() if k not in own} for event in printed] == recognised
    eventually(lambda: len(subscriber.events) == len(printed))
    for got in (webhook.got, subscriber.events):
        assert got == printed
        assert set(Counter(event["id"] for event in got).values()) == {1}
    floor = "silhouette-pose/ward.1/zones/the_floor_"
    occupied = [v for topic, v in subscriber.retained.items() if topic.startswith(floor)]
    assert occupied in (["ON"], ["OFF"])
    assert subscriber.retained["silhouette-pose/ward.1/fell"] == "ON"
    discovered = {t for t in subscriber.retained if t.startswith("homeassistant/")}
    assert len(discovered) == 3
    for topic in discovered:
        assert json.loads(subscriber.retained[topic])["state_topic"] in subscriber.retained
    home.close()
    eventually(lambda: subscriber.retained["silhouette-pose/ward.1/available"] == "offline")
    stopping.set()
    subscriber.close()
    broker.stop()
    webhook.stop()
