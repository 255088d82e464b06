"""Events and presence over MQTT, with the discovery of Home Assistant.

Topics below ``silhouette-pose/CAMERA_ID/``: ``events`` has each event as JSON. All others are
retained: ``available`` (online, or offline from :data:`BLIND_AFTER_S` without an answered frame),
``people`` (a number), ``posture``, ``zones/ZONE`` and ``obstructed`` (ON or OFF), which are None
while offline, ``fell`` (the event as JSON, but with the ``state`` ON for :data:`FELL_SHOWN_S`, then
OFF), ``last_fall`` (its time) and ``replay`` (what was seen of it, an animated WebP), which stay.
"""

import contextlib
import json
import math
import re
import threading
import time
import zlib
from collections.abc import Callable, Collection, Mapping
from typing import Any
from urllib.parse import SplitResult, unquote

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from app import VERSION
from app.bridge import RefusedError, Trouble, UnavailableError, say
from app.bridge.outbox import Message
from app.configuration import EVENT_NAMES

BLIND_AFTER_S = 15.0
FELL_SHOWN_S = 60
DISCOVERY_PREFIX = "homeassistant"
_UNKNOWN = "None"  # As Home Assistant's sensors have it.
_WITH_AN_END = ("lying", "arms_raised", "obstructed")
EVENT_TYPES = [*EVENT_NAMES, *(f"{name}_ended" for name in _WITH_AN_END)]
POSTURES = [
    *("nobody", "unclear", "standing", "walking", "running", "arms_raised", "bending", "kneeling"),
    *("crouching", "sitting", "crawling", "lying"),
]
"""Of several people's postures, the one furthest down is shown."""
_EVENT_TEMPLATE = (
    "{% set end = '_ended' if value_json.state == 'end' else '' %}"
    "{{ dict(value_json, event_type=value_json.event ~ end) | tojson }}"
)
_PROBLEM = {"device_class": "problem"}
_FELL = {"value_template": "{{ value_json.state }}", "json_attributes_topic": "fell"}
# Component, title, and what else Home Assistant is told of what is shown of a camera.
_ENTITIES: Mapping[str, tuple[str, str, Mapping[str, Any]]] = {
    "fell": ("binary_sensor", "Fell", _PROBLEM | _FELL),
    "obstructed": ("binary_sensor", "Obstructed", _PROBLEM),
    "people": ("sensor", "People", {"state_class": "measurement"}),
    "posture": ("sensor", "Posture", {"device_class": "enum", "options": POSTURES}),
    "last_fall": ("sensor", "Last fall", {"device_class": "timestamp"}),
    "replay": ("image", "Last fall", {"image_topic": "replay", "content_type": "image/webp"}),
    "events": ("event", "Events", {"event_types": EVENT_TYPES, "value_template": _EVENT_TEMPLATE}),
}
# These stay as they are while the camera is offline.
_STAYING = ("last_fall", "replay", "events")
_ANSWERS_WITHIN_S = 5.0
_RETRY_AFTER_S = 10.0
_SILENT_S = 1.0


def slug(name: str) -> str:
    """Return a name in the characters that topics of discovery allow; different names differ.

    Examples
    --------
    >>> slug("bed"), slug("bed 2")
    ('bed', 'bed_2_3ba5c2df')
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", name)
    return plain if plain == name else f"{plain}_{zlib.crc32(name.encode()):08x}"


class HomeAssistant:
    """A connection to a broker that reconnects by itself.

    One thread calls :meth:`keep` and :meth:`send`; any may call :meth:`show`. The address is
    ``mqtt://[user:password@]host[:port]``, or ``mqtts://`` for TLS. ``replay`` returns what was
    seen of an event by its id.
    """

    def __init__(
        self,
        address: SplitResult,
        camera_id: str,
        name: str | None = None,
        link: str | None = None,
        replay: Callable[[str], bytes] | None = None,
    ) -> None:
        self._device = f"silhouette_pose_{slug(camera_id)}"
        self._info = {
            "identifiers": [self._device],
            "name": name or f"Silhouette pose {camera_id}",
            "manufacturer": "silhouette-pose",
            "model": "Camera",
            "sw_version": VERSION,
            **({"configuration_url": link} if link else {}),
        }
        self._base = f"silhouette-pose/{camera_id}/"
        self._replay, self._replays_at = replay, list[float]()
        self._fell_until = self._seen_at = 0.0
        self._fall_shown = ""  # Its id.
        self._is_closed = self._is_withdrawn = False
        self._connected_at = math.inf
        # Retained messages by topic: those that there should be, and those that the broker has.
        self._state: dict[str, str | bytes] = {}
        self._published: dict[str, str | bytes] = {}
        self._retry_at: dict[str, float] = {}
        # Names by topics of announcements, also of an earlier start.
        self._entities: dict[str, str] = {}
        self._answers: dict[int, Any] = {}
        self._changed = threading.Condition()
        self._outage, self._outage_began = "does not answer", time.monotonic()
        self._trouble = Trouble("mqtt: the broker answers again")
        # Announcements first: where all is withdrawn, Home Assistant reads no empty states.
        for entity, described in _ENTITIES.items():
            self._announce(entity, *described)
        self._set(available="offline", fell=json.dumps({"state": "OFF"}))
        # By its name, the broker knows that an earlier connection of this camera is dead.
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, self._device, protocol=mqtt.MQTTv5)
        if address.scheme == "mqtts":
            self._client.tls_set()
        if address.username is not None:
            password = None if address.password is None else unquote(address.password)
            self._client.username_pw_set(unquote(address.username), password)
        self._client.will_set(f"{self._base}available", "offline", qos=1, retain=True)
        self._client.reconnect_delay_set(1, 10)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_publish = self._on_publish
        self._client.on_message = self._on_message
        port = address.port or (8883 if address.scheme == "mqtts" else 1883)
        # The broker reports a dead machine after one and a half times this, in BLIND_AFTER_S, too.
        self._client.connect_async(address.hostname or "", port, keepalive=10)
        self._client.loop_start()

    def send(self, message: Message) -> None:
        """Publish an event; return once the broker has it."""
        if not self._client.is_connected():
            raise UnavailableError(f"the broker {self._outage}")
        if message["event"] == "fell" and message["id"] != self._fall_shown:
            self._fell_until = time.monotonic() + FELL_SHOWN_S
            self._fall_shown = message["id"]
            # At once, and again when it is complete.
            self._replays_at = [time.monotonic(), time.monotonic() + 4.0]
            with self._changed:
                fall = json.dumps({**message, "state": "ON"})
                self._set(fell=fall, last_fall=message["time"])
        # Before those two, so that an automation knows which falls it was told of.
        self._publish(f"{self._base}events", json.dumps(message))

    def show(
        self,
        people: int,
        zones: Mapping[str, bool] | None,
        postures: Collection[str] = (),
        *,
        obstructed: bool = False,
    ) -> None:
        """Show people, their postures, which zones are occupied, and if the view is blocked.

        Zones are None while they are not known; new ones are announced. Those that are gone, even
        since an earlier start, are withdrawn.
        """
        with self._changed:
            self._seen_at = time.monotonic()
            if zones is not None:
                self._show_zones(zones)
            known = [*filter(POSTURES.__contains__, postures), "unclear" if people else "nobody"]
            posture = max(known, key=POSTURES.index)
            blocked = "ON" if obstructed else "OFF"
            self._set(available="online", people=str(people), posture=posture, obstructed=blocked)

    def _show_zones(self, zones: Mapping[str, bool]) -> None:
        shown = {f"zones/{slug(zone)}": zone for zone in zones}
        for name, zone in shown.items():
            self._announce(name, "binary_sensor", zone, {"device_class": "occupancy"})
            self._set(**{name: "ON" if zones[zone] else "OFF"})
        self._clear(lambda name: name.startswith("zones/") and name not in shown)

    def _set(self, **payloads: str | bytes) -> None:
        """Change what is retained below the topic of the camera."""
        self._state |= {f"{self._base}{name}": payload for name, payload in payloads.items()}

    def _clear(self, is_meant: Callable[[str], bool]) -> None:
        """Withdraw entities by their names."""
        for config, name in self._entities.items():
            if is_meant(name):
                self._state[config] = ""
                if name != "events":  # Which are not retained.
                    self._set(**{name: ""})

    def keep(self) -> None:
        """Publish what has changed; the camera is offline if no frame was answered for too long."""
        now = time.monotonic()
        with self._changed:
            is_online = self._state[f"{self._base}available"] == "online"
            if is_online and now > self._seen_at + BLIND_AFTER_S:
                say(f"no frame was answered for {BLIND_AFTER_S:g} s: the camera is offline")
                self.hide()
            if self._fell_until and now > self._fell_until:
                self._fell_until = 0.0
                fall = json.loads(self._state[f"{self._base}fell"])
                self._set(fell=json.dumps({**fall, "state": "OFF"}))
        if not self._client.is_connected():
            if now > self._outage_began + _ANSWERS_WITHIN_S:
                self._trouble.report(f"mqtt: the broker {self._outage}")
            return
        self._trouble.end()
        self._fetch_replay(now)
        for topic in [topic for topic in self.news() if now >= self._retry_at.get(topic, 0.0)]:
            try:
                self._retain(topic)
            except UnavailableError as error:
                if topic not in self._retry_at and not self._is_closed:
                    say(f"mqtt: {error}")
                self._retry_at[topic] = now + _RETRY_AFTER_S

    def _fetch_replay(self, now: float) -> None:
        """Fetch the replay of the last fall when it is due; the next time will do if that fails."""
        if self._replay is None or not self._replays_at or now < self._replays_at[0]:
            return
        del self._replays_at[0]
        try:
            content = self._replay(self._fall_shown)
        except (RefusedError, UnavailableError) as error:
            say(f"no replay of the fall: {error}")
            return
        with self._changed:
            self._set(replay=content)

    def hide(self) -> None:
        """Show that the camera is offline; what it sees becomes unknown."""
        with self._changed:
            self._set(available="offline")
            for name in self._entities.values():
                if name not in ("fell", *_STAYING) and self._state.get(f"{self._base}{name}"):
                    self._set(**{name: _UNKNOWN})

    def withdraw(self) -> None:
        """Clear all that the broker retains of this camera, which is watched no more."""
        with self._changed:
            self._is_withdrawn = True
            self._state = dict.fromkeys(self._state, "")

    @property
    def is_gone(self) -> bool:
        """Whether the broker retains nothing of a camera that was withdrawn."""
        has_heard = time.monotonic() > self._connected_at + _SILENT_S
        return has_heard and self._client.is_connected() and not self.news()

    def close(self) -> None:
        """Disconnect; nothing is published any more."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._client.disconnect()
        self._client.loop_stop()

    def news(self) -> list[str]:
        """Return the topics whose retained message the connected broker does not have yet."""
        if not self._client.is_connected():
            return []
        with self._changed:
            return [t for t, payload in self._state.items() if self._published.get(t) != payload]

    def _retain(self, topic: str) -> None:
        """Publish a retained message as it should be."""
        with self._changed:
            payload = self._state[topic]
        options = {}
        if topic == f"{self._base}fell" and self._fell_until:
            # Even if this program ends: nobody shall take it for a new fall later on.
            options["properties"] = Properties(PacketTypes.PUBLISH)
            options["properties"].MessageExpiryInterval = FELL_SHOWN_S
        self._publish(topic, payload, retain=True, **options)
        with self._changed:
            self._published[topic] = payload
        self._retry_at.pop(topic, None)

    def _publish(self, topic: str, payload: str | bytes, **options: Any) -> None:
        """Publish, and wait for the broker's answer.

        It waits through reconnections, after which the client sends again what has no answer.
        """
        number = self._client.publish(topic, payload, qos=1, **options).mid
        with self._changed:
            while not self._changed.wait_for(
                lambda: self._is_closed or number in self._answers, _ANSWERS_WITHIN_S
            ):
                self._trouble.report(f"mqtt: the broker {self._outage}")
            if number not in self._answers:
                raise UnavailableError("the connection was closed")
            answer = self._answers.pop(number)
        if answer.is_failure:
            raise UnavailableError(f"the broker refuses {topic}: {answer}")

    def _announce(self, name: str, component: str, title: str, fields: Mapping[str, Any]) -> None:
        """Announce an entity of Home Assistant; topics are below that of the camera."""
        entity = name.replace("/", "_")
        given = {
            "name": title,
            "unique_id": f"{self._device}_{entity}",
            "state_topic": name,
            **({} if name in _STAYING else {"availability_topic": "available"}),
            "device": self._info,
            "origin": {"name": "silhouette-pose-watch", "sw_version": VERSION},
            **fields,
        }
        given |= {key: f"{self._base}{given[key]}" for key in given if key.endswith("_topic")}
        config = f"{DISCOVERY_PREFIX}/{component}/{self._device}/{entity}/config"
        self._entities[config] = name
        self._state[config] = json.dumps(given)

    def _on_connect(
        self, _client: mqtt.Client, _data: Any, _flags: Any, answer: Any, _: Any
    ) -> None:
        with self._changed:
            self._outage = f"refuses: {answer}" if answer.is_failure else "does not answer"
            self._published.clear()
        self._connected_at = time.monotonic()
        self._client.subscribe(f"{DISCOVERY_PREFIX}/+/{self._device}/+/config")

    def _on_message(self, _client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        """Note an announcement of an earlier start."""
        with contextlib.suppress(ValueError, KeyError, TypeError), self._changed:
            if message.retain:
                topic = str(json.loads(message.payload)["state_topic"])
                self._entities[message.topic] = topic.removeprefix(self._base)
                if self._is_withdrawn:
                    self._clear(lambda name: True)

    def _on_disconnect(self, *_: Any) -> None:
        self._outage_began = time.monotonic()

    def _on_publish(
        self, _client: mqtt.Client, _data: Any, number: int, answer: Any, _: Any
    ) -> None:
        with self._changed:
            self._answers[number] = answer
            self._changed.notify_all()
