"""A real Home Assistant: what it shows of a camera, and how often it notifies of a fall.

It is a program of another environment, with Python 3.13: ``pip install homeassistant==2025.4.4
home-assistant-frontend==20250411.0 paho-mqtt==2.1.0``; HASS is the path of its ``hass``.
"""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.app.bridge.cameras import MjpegCamera
from tests.app.bridge.servers import event
from tests.app.bridge.test_watch import Running, bridge
from tests.conftest import ROOT
from tests.support.broker import MOSQUITTO, Broker
from tests.support.ports import free_ports
from tests.support.programs import none_left_running
from tests.support.service import eventually

__all__ = ["bridge"]

HASS = os.environ.get("HASS", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (HASS and MOSQUITTO), reason="needs HASS=PATH, and mosquitto"),
]
BLUEPRINT = ROOT / "deploy" / "home-assistant" / "notify.yaml"
AUTOMATION = {
    "alias": "Fall",
    "use_blueprint": {
        "path": "silhouette-pose/notify.yaml",
        "input": {
            "events": "event.ward_3_events",
            "last_fall": "sensor.ward_3_last_fall",
            "actions": [{"action": "shell_command.note", "data": {"text": "{{ time }}"}}],
        },
    },
}


@pytest.fixture(autouse=True)
def _ended() -> Iterator[None]:
    """A failed run leaves no program behind."""
    with none_left_running():
        yield


class HomeAssistant:
    """It writes a line into a file for each notification."""

    def __init__(self, folder: Path, broker_port: int) -> None:
        (port,) = free_ports(1)
        self._url, self._folder, self._notes = f"http://127.0.0.1:{port}", folder, folder / "notes"
        self._notes.touch()
        (folder / "note.sh").write_text(f'echo "$*" >> {self._notes}\n')
        blueprints = folder / "blueprints" / "automation" / "silhouette-pose"
        blueprints.mkdir(parents=True)
        shutil.copy(BLUEPRINT, blueprints)
        configuration = {
            "http": {"server_port": port, "server_host": "127.0.0.1"},
            "api": {},
            "automation": [AUTOMATION],
            "shell_command": {"note": f"bash {folder}/note.sh {{{{ text }}}}"},
        }
        (folder / "configuration.yaml").write_text(json.dumps(configuration))
        (folder / ".storage").mkdir()
        entry = {
            **{"entry_id": "broker", "domain": "mqtt", "title": "broker", "version": 1},
            **{"minor_version": 2, "source": "user", "unique_id": None, "subentries": []},
            **dict.fromkeys(("pref_disable_new_entities", "pref_disable_polling"), False),
            **dict.fromkeys(("created_at", "modified_at"), "2026-01-01T00:00:00+00:00"),
            **{"disabled_by": None, "discovery_keys": {}, "options": {}},
            "data": {"broker": "127.0.0.1", "port": broker_port},
        }
        stored = {"version": 1, "minor_version": 5, "data": {"entries": [entry]}}
        path = folder / ".storage" / "core.config_entries"
        path.write_text(json.dumps({"key": "core.config_entries", **stored}))
        self.start()
        client = {"client_id": f"{self._url}/"}
        user = {"name": "a", "username": "a", "password": "password", "language": "en"}
        code = httpx.post(f"{self._url}/api/onboarding/users", json=client | user).json()
        grant = {"grant_type": "authorization_code", "code": code["auth_code"], **client}
        self._token = httpx.post(f"{self._url}/auth/token", data=grant).json()["access_token"]

    def start(self) -> None:
        command = [HASS, "-c", str(self._folder), "--skip-pip"]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        eventually(self._is_there, 120)

    def stop(self, number: int = signal.SIGTERM) -> None:
        self._process.send_signal(number)
        self._process.wait(60)

    def states(self) -> dict[str, str]:
        """States of the camera's entities, whose names are without "ward_3_"."""
        headers = {"Authorization": f"Bearer {self._token}"}
        answer = httpx.get(f"{self._url}/api/states", headers=headers)
        found = answer.json() if answer.is_success else []  # It refuses while it starts.
        ours = [one for one in found if ".ward_3_" in one["entity_id"]]
        return {one["entity_id"].replace("ward_3_", ""): one["state"] for one in ours}

    @property
    def notes(self) -> list[str]:
        return self._notes.read_text().splitlines()

    def _is_there(self) -> bool:
        try:
            return httpx.get(f"{self._url}/api/").status_code == 401
        except httpx.HTTPError:
            return False


def test_a_fall_is_told_of_once_whatever_is_restarted(
    bridge: Callable[..., Running], tmp_path: Path
) -> None:
    folder = tmp_path / "config"
    folder.mkdir()
    broker, running = Broker(tmp_path), bridge()
    home = HomeAssistant(folder, broker.port)

    def fall() -> None:
        running.service.events = [event("fell", time.time())]
        eventually(lambda: not running.service.events)

    def seen(name: str) -> Any:
        return home.states().get(name)

    with MjpegCamera() as live:
        ward = {"ward": {"source": live, "name": "Ward 3"}}
        running.says(ward, mqtt=broker.address)
        eventually(lambda: seen("sensor.posture") == "nobody", 60)
        assert home.states().keys() == {
            *("binary_sensor.fell", "binary_sensor.obstructed", "sensor.people", "sensor.posture"),
            *("event.events", "sensor.last_fall", "image.last_fall"),
        }
        fall()
        eventually(lambda: len(home.notes) == 1 and seen("binary_sensor.fell") == "on")
        broker.stop()
        broker.start()
        for number in (signal.SIGTERM, signal.SIGKILL):
            home.stop(number)
            home.start()
            eventually(lambda: seen("sensor.people") == "0", 60)
            time.sleep(5)
            assert len(home.notes) == 1
        home.stop()
        time.sleep(60)  # Clocks may differ by as much.
        fall()
        home.start()
        eventually(lambda: len(home.notes) == 2, 60)
        assert len(set(home.notes)) == 2
        time.sleep(60)
        broker.stop()
        time.sleep(5)
        fall()
        broker.start()
        eventually(lambda: len(home.notes) == 3, 60)
        time.sleep(10)
        assert len(home.notes) == 3
        running.says({"den": {"source": live}}, mqtt=broker.address)
        eventually(lambda: not home.states(), 60)
    home.stop()
    broker.stop()
