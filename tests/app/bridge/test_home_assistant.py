"""What a real broker and Home Assistant are sent."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import jinja2
import pytest

import app.bridge as common_module
from app.bridge import home_assistant as module
from app.bridge.home_assistant import HomeAssistant
from app.bridge.outbox import Message, Outbox, deliver
from app.configuration import EVENT_NAMES
from tests.app.bridge.servers import event
from tests.conftest import ROOT
from tests.support.broker import MOSQUITTO, Broker, Subscriber
from tests.support.service import eventually

pytestmark = pytest.mark.skipif(not MOSQUITTO, reason="needs mosquitto: apt-get install mosquitto")

BASE = "silhouette-pose/ward.1"


class Ward(NamedTuple):
    broker: Broker
    home: HomeAssistant
    outbox: Outbox
    subscriber: Subscriber

    def shows(self, **topics: str) -> Callable[[], bool]:
        """Whether the broker has these payloads."""
        wanted = {f"{BASE}/{name}": payload for name, payload in topics.items()}
        return lambda: wanted.items() <= self.subscriber.latest.items()

    @property
    def fell(self) -> dict[str, object]:
        return json.loads(self.subscriber.latest.get(f"{BASE}/fell", "{}"))


@pytest.fixture
def ward(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ward]:
    """A camera, its broker and a listener."""
    monkeypatch.setattr(common_module, "WAITS_S", (0.1,))
    monkeypatch.setattr(module, "_RETRY_AFTER_S", 0.1)
    broker = Broker(tmp_path)
    home = HomeAssistant(
        urlsplit(broker.address), "ward.1", replay=lambda event: b"of " + event.encode()
    )
    outbox, stopping = Outbox("ward.1", ["mqtt"]), threading.Event()
    work = (outbox, stopping, "mqtt", home.send, home.keep)
    thread = threading.Thread(target=deliver, args=work)
    thread.start()
    subscriber = Subscriber(broker.port)
    yield Ward(broker, home, outbox, subscriber)
    stopping.set()
    thread.join()
    subscriber.close()
    broker.stop()


def message(number: int, name: str = "fell") -> Message:
    time = "2026-01-01T12:00:00.000+00:00"
    return {**event(name, 12.0), "id": str(number), "camera_id": "ward.1", "time": time}


def test_what_the_broker_refuses_waits(ward: Ward, capsys: pytest.CaptureFixture[str]) -> None:
    ward.broker.refuse(f"{BASE}/events", f"{BASE}/people")
    eventually(lambda: ward.fell)
    log = ""

    def refused() -> bool:
        nonlocal log
        log += capsys.readouterr().err
        return all(
            f"refuses {BASE}/{topic}: Not authorized" in log for topic in ("events", "people")
        )

    ward.outbox.put(message(1, "entered"))
    ward.home.show(2, {})
    eventually(refused)
    assert len(ward.outbox) == 1
    ward.broker.refuse()
    eventually(lambda: not len(ward.outbox))
    eventually(ward.shows(people="2"))
    eventually(lambda: ward.subscriber.events == [message(1, "entered")])
    assert (log + capsys.readouterr().err).count("refuses") == 2


def test_who_sees_nothing_is_offline(ward: Ward, monkeypatch: pytest.MonkeyPatch) -> None:
    eventually(ward.shows(available="offline"))
    ward.home.show(1, {"bed": True, "floor": False}, {"sitting", "lying"}, obstructed=True)
    shown = {"people": "1", "obstructed": "ON", "zones/bed": "ON", "posture": "lying"}
    eventually(ward.shows(available="online", **shown))
    with monkeypatch.context() as patch:
        patch.setattr(module, "BLIND_AFTER_S", 0.1)
        eventually(ward.shows(available="offline", **dict.fromkeys(shown, "None")))
    ward.home.show(0, {"floor": True})
    shown = {"people": "0", "obstructed": "OFF", "zones/floor": "ON", "posture": "nobody"}
    eventually(ward.shows(available="online", **shown))
    # The zone that is gone is no longer announced.
    discovered = {
        topic for topic, payload in ward.subscriber.latest.items() if "/config" in topic and payload
    }
    assert {topic.split("/")[-2] for topic in discovered} == {
        "events", "fell", "last_fall", "obstructed", "people", "posture", "replay", "zones_floor"
    }  # fmt: skip
    ward.home.hide()
    eventually(ward.shows(available="offline", people="None", **{"zones/floor": "None"}))


def test_a_fall_is_shown_for_a_while_with_its_time(
    ward: Ward, monkeypatch: pytest.MonkeyPatch
) -> None:
    eventually(lambda: ward.fell == {"state": "OFF"})
    config = f"homeassistant/binary_sensor/silhouette_pose_{module.slug('ward.1')}/fell/config"
    eventually(lambda: config in ward.subscriber.latest)
    template = jinja2.Template(json.loads(ward.subscriber.latest[config])["value_template"])
    assert template.render(value_json=ward.fell) == "OFF"
    ward.outbox.put(message(1))
    eventually(lambda: ward.fell == {**message(1), "state": "ON"})
    assert template.render(value_json=ward.fell) == "ON"
    ward.broker.stop()
    ward.outbox.put(message(2))
    ward.broker.start()
    eventually(lambda: ward.fell == {**message(2), "state": "ON"})
    # Only now: a listener that returns later than a fall is shown would not see it.
    monkeypatch.setattr(module, "FELL_SHOWN_S", 1)
    ward.outbox.put(message(3))
    eventually(lambda: ward.fell == {**message(3), "state": "OFF"})


def test_each_event_is_one_of_an_entity_and_the_last_fall_stays(ward: Ward) -> None:
    def config(topic: str) -> dict[str, Any]:
        return json.loads(ward.subscriber.latest[f"homeassistant/{topic}/config"])

    eventually(ward.shows(available="offline"))  # The subscriber is there.
    sent = [message(1, "entered"), message(2), {**message(3, "lying"), "state": "end"}]
    for one in sent:
        ward.outbox.put(one)
    eventually(lambda: len(ward.subscriber.events) == 3)
    eventually(ward.shows(last_fall=message(2)["time"], replay="of 2"))
    device = next(t for t in ward.subscriber.latest if t.endswith("/last_fall/config")).split("/")[
        2
    ]
    entity = config(f"event/{device}/events")
    template = jinja2.Template(entity["value_template"])
    read = [json.loads(template.render(value_json=one)) for one in ward.subscriber.events]
    assert [one.pop("event_type") for one in read] == ["entered", "fell", "lying_ended"]
    assert read == sent
    assert {name.removesuffix("_ended") for name in entity["event_types"]} == {*EVENT_NAMES}
    # Neither becomes unavailable, so that nothing is taken for new once the camera is back.
    late = Subscriber(ward.broker.port, "late")
    eventually(lambda: f"{BASE}/last_fall" in late.latest)
    assert entity["state_topic"] == f"{BASE}/events" and late.events == []
    assert config(f"image/{device}/replay")["image_topic"] == f"{BASE}/replay"
    for topic in (f"event/{device}/events", f"sensor/{device}/last_fall"):
        assert "availability_topic" not in config(topic)
    late.close()


def test_a_zone_that_went_while_the_bridge_did_not_run_is_withdrawn(ward: Ward) -> None:
    ward.home.show(0, {"bed": True, "floor": False})
    eventually(ward.shows(**{"zones/bed": "ON", "zones/floor": "OFF"}))
    ward.home.close()
    successor = HomeAssistant(urlsplit(ward.broker.address), "ward.1")
    eventually(lambda: len(successor.news()) > 0)
    successor.show(0, None)  # The service has not named its zones yet.
    successor.keep()
    time.sleep(0.5)
    assert ward.subscriber.latest[f"{BASE}/zones/bed"] == "ON"
    successor.show(0, {"floor": False})
    successor.keep()
    eventually(ward.shows(**{"zones/bed": "", "zones/floor": "OFF"}))
    discovered = [t for t, text in ward.subscriber.latest.items() if "zones" in t and text]
    assert {t.split("/")[-2] for t in discovered if t.endswith("/config")} == {"zones_floor"}


HANGS = """
import sys, time, urllib.parse
from app.bridge.home_assistant import HomeAssistant
home = HomeAssistant(urllib.parse.urlsplit(sys.argv[1]), "ward.1")
while True:
    home.keep()
    time.sleep(0.1)
"""


def test_the_end_of_a_bridge_that_hung_does_not_turn_its_successor_off(ward: Ward) -> None:
    hung = subprocess.Popen([sys.executable, "-c", HANGS, ward.broker.address], cwd=ROOT)
    ward.home.show(1, {})
    eventually(ward.shows(available="online"))

    def available() -> list[str]:
        topic = f"{BASE}/available"
        return [said for _, one, said in list(ward.subscriber.history) if one == topic]

    # It may be back at once.
    eventually(lambda: "offline" in available()[available().index("online") :])
    hung.send_signal(signal.SIGSTOP)
    eventually(ward.shows(available="online"))
    hung.kill()
    hung.wait()
    time.sleep(0.5)
    assert ward.shows(available="online")()
