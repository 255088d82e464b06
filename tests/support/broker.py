"""A real MQTT broker, which can be stopped and started again, and a subscriber."""

import json
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

from paho.mqtt import client as mqtt

from tests.support.ports import free_ports

MOSQUITTO = next((p for p in ("/usr/sbin/mosquitto", "/usr/bin/mosquitto") if Path(p).exists()), "")


class Broker:
    """Debian's mosquitto; it keeps what is retained and the queues of subscribers over a restart.

    The user ``bridge`` may write everything but the topics that are refused.
    """

    def __init__(self, folder: Path, refused: tuple[str, ...] = ()) -> None:
        (self.port,) = free_ports(1)
        self.address = f"mqtt://bridge:s3cret@127.0.0.1:{self.port}"
        self._config, self._rules = folder / "mosquitto.conf", folder / "rules"
        self._config.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\nuser root\n"
            f"persistence true\npersistence_location {folder}/\n"
            f"autosave_on_changes true\nautosave_interval 1\nacl_file {self._rules}\n"
        )
        self._write_rules(refused)
        self.start()

    def start(self) -> None:
        """Start it, and wait until it listens."""
        self._process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self._config)], stderr=subprocess.DEVNULL
        )
        for _ in range(3000):
            try:
                socket.create_connection(("127.0.0.1", self.port)).close()
                return
            except OSError:
                time.sleep(0.02)
        raise TimeoutError("mosquitto does not listen")

    def refuse(self, *topics: str) -> None:
        """Change which topics are refused."""
        self._write_rules(topics)
        self._process.send_signal(signal.SIGHUP)

    def stop(self, number: int = signal.SIGTERM) -> None:
        """End it; asked to, it writes to its file what it holds for others."""
        self._process.send_signal(number)
        self._process.wait(timeout=60)

    def _write_rules(self, refused: tuple[str, ...]) -> None:
        lines = ["topic readwrite #", "user bridge", *(f"topic deny {topic}" for topic in refused)]
        self._rules.write_text("\n".join([*lines, "topic readwrite #", ""]))


class Subscriber:
    """A receiver whose session the broker keeps while it is away."""

    def __init__(self, port: int, name: str = "home") -> None:
        self.events: list[dict[str, Any]] = []
        self.latest: dict[str, str] = {}
        self.history: list[tuple[float, str, str]] = []
        self._client = mqtt.Client(
            mqtt.CallbackAPIVersion.VERSION2, client_id=name, clean_session=False
        )
        self._client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        self._client.on_message = self._take
        self._client.reconnect_delay_set(1, 1)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def _take(self, _client: Any, _data: Any, message: Any) -> None:
        payload = message.payload.decode()
        self.history.append((time.monotonic(), message.topic, payload))
        self.latest[message.topic] = payload
        if message.topic.endswith("/events"):
            self.events.append(json.loads(payload))

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()
        self._client.loop_stop()
