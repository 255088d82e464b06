"""Events and presence over MQTT, with the discovery of Home Assistant.

Topics below ``silhouette-pose/CAMERA_ID/``: ``events`` has each event as JSON; ``people`` a number,
``zones/ZONE`` ON or OFF and ``available`` online or offline, all retained; ``fell`` is ON for
:data:`FELL_SHOWN_S` after a fall.
"""

from __future__ import annotations

import json
import re
import threading
import zlib
from collections.abc import Iterable
from typing import Any
from urllib.parse import unquote, urlsplit

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from scripts.watch_camera.outbox import DeliveryError, Message
from scripts.watch_camera.presence import Presence

FELL_SHOWN_S = 60
DISCOVERY_PREFIX = "homeassistant"
_TIMEOUT_S = 10.0
_MAX_PAUSE_S = 10


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

    Parameters
    ----------
    url : str
        ``mqtt://[user:password@]host[:port]``, or ``mqtts://`` for TLS.
    camera_id : str
    """

    def __init__(self, url: str, camera_id: str) -> None:
        parts = urlsplit(url)
        secure = parts.scheme == "mqtts"
        self._camera_id, self._base = camera_id, f"silhouette-pose/{camera_id}"
        self._retained: dict[str, str] = {f"{self._base}/available": "online"}
        self._zones: list[str] = []
        self._acknowledged: set[int] = set()
        self._changed = threading.Condition()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        if secure:
            self._client.tls_set()
        if parts.username is not None:
            password = None if parts.password is None else unquote(parts.password)
            self._client.username_pw_set(unquote(parts.username), password)
        self._client.will_set(f"{self._base}/available", "offline", qos=1, retain=True)
        self._client.reconnect_delay_set(1, _MAX_PAUSE_S)
        self._client.on_connect = self._on_connect
        self._client.on_publish = self._on_publish
        self._announce(
            "binary_sensor", "fell", "fell", device_class="problem", off_delay=FELL_SHOWN_S
        )
        self._announce("sensor", "people", "people", state_class="measurement")
        self._client.connect_async(
            parts.hostname or "127.0.0.1", parts.port or (1883, 8883)[secure]
        )
        self._client.loop_start()

    def send(self, message: Message) -> None:
        """Publish an event; return once the broker has it."""
        if not self._client.is_connected():
            raise DeliveryError("the broker does not answer")
        if message["event"] == "fell":
            # Retained, since a listener may return later than this after a restart of the broker;
            # expiring, so that nobody takes it for a new fall later on.
            expiry = Properties(PacketTypes.PUBLISH)
            expiry.MessageExpiryInterval = FELL_SHOWN_S
            self._publish_surely("fell", "ON", retain=True, properties=expiry)
        self._publish_surely("events", json.dumps(message))

    def show(self, presence: Presence, zones: Iterable[str]) -> None:
        """Publish how many people there are and which zones are occupied; announce new zones."""
        zones = list(zones)
        for gone in [zone for zone in self._zones if zone not in zones]:
            self._retain(self._config("binary_sensor", f"zone_{slug(gone)}"), "")
        for new in [zone for zone in zones if zone not in self._zones]:
            self._announce(
                "binary_sensor",
                f"zones/{slug(new)}",
                new,
                device_class="occupancy",
                identity=f"zone_{slug(new)}",
            )
        self._zones = zones
        self._retain(f"{self._base}/people", str(presence.people))
        for zone in zones:
            state = "ON" if presence.is_occupied(zone) else "OFF"
            self._retain(f"{self._base}/zones/{slug(zone)}", state)

    def close(self) -> None:
        """Report that the camera is no longer watched, and disconnect."""
        if self._client.is_connected():
            topic = f"{self._base}/available"
            self._client.publish(topic, "offline", qos=1, retain=True).wait_for_publish(_TIMEOUT_S)
        self._client.disconnect()
        self._client.loop_stop()

    def _publish_surely(self, topic: str, payload: str, **options: Any) -> None:
        # Waits through reconnections, after which the client sends again what is not acknowledged.
        self._acknowledged.clear()
        number = self._client.publish(f"{self._base}/{topic}", payload, qos=1, **options).mid
        with self._changed:
            self._changed.wait_for(lambda: number in self._acknowledged)

    def _config(self, component: str, identity: str) -> str:
        device = f"silhouette_pose_{slug(self._camera_id)}"
        return f"{DISCOVERY_PREFIX}/{component}/{device}/{identity}/config"

    def _announce(
        self, component: str, topic: str, name: str, identity: str | None = None, **fields: Any
    ) -> None:
        """Announce an entity of Home Assistant."""
        device = f"silhouette_pose_{slug(self._camera_id)}"
        identity = identity or topic
        config = {
            "name": name,
            "unique_id": f"{device}_{identity}",
            "state_topic": f"{self._base}/{topic}",
            "availability_topic": f"{self._base}/available",
            "device": {"identifiers": [device], "name": f"Silhouette pose {self._camera_id}"},
            **fields,
        }
        self._retain(self._config(component, identity), json.dumps(config))

    def _retain(self, topic: str, payload: str) -> None:
        """Publish a retained message unless the broker has it; repeated after each reconnection."""
        with self._changed:
            if self._retained.get(topic) == payload:
                return
            self._retained[topic] = payload
        if self._client.is_connected():
            self._client.publish(topic, payload, qos=0, retain=True)

    def _on_connect(self, client: mqtt.Client, *_: Any) -> None:
        with self._changed:
            retained = dict(self._retained)
        for topic, payload in retained.items():
            client.publish(topic, payload, qos=0, retain=True)

    def _on_publish(self, _client: mqtt.Client, _data: Any, number: int, *_: Any) -> None:
        with self._changed:
            self._acknowledged.add(number)
            self._changed.notify_all()
