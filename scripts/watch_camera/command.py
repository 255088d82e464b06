"""Watch a camera: frames to a service, its events to a webhook and to MQTT.

    python -m scripts watch-camera SOURCE CAMERA_ID [--url URL] [--fps 10] [--api-key KEY]
        [--webhook URL] [--mqtt mqtt://user:password@host] [--queue FILE]

SOURCE is a video file, the number of a device (0) or the URL of a stream (rtsp://...). The newest
frame is posted whenever the service has answered the last one. Each event is printed as a line of
JSON, and delivered once to each receiver: it waits, with ``--queue`` even through a restart of this
program, until it is taken. A receiver that gets an event twice, because an acknowledgement was
lost, recognises it by its ``id``. Everything else is printed to standard error.
"""

from __future__ import annotations

import argparse
import http.client
import importlib.util
import json
import os
import signal
import sys
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.watch_camera import service
from scripts.watch_camera.common import say
from scripts.watch_camera.outbox import Message, Outbox, deliver
from scripts.watch_camera.presence import Presence
from scripts.watch_camera.service import Camera, RefusedError
from scripts.watch_camera.source import Frame, Source
from scripts.watch_camera.webhook import Webhook

if TYPE_CHECKING:
    from scripts.watch_camera.home_assistant import HomeAssistant

STATUS_EVERY_S = 10.0
STOPS_WITHIN_S = 5.0
_SEEN_EVENTS = 1000
_PASSING = (408, 409, 429, 502, 503, 504)
"""Statuses of a service that will take a later frame."""

Event = Mapping[str, Any]


class Bridge:
    """Posts a camera's frames and passes the events on.

    Parameters
    ----------
    camera : Camera
    outbox : Outbox
    receivers : sequence of str
        Names of the receivers of each event.
    home_assistant : HomeAssistant or None
        Shows how many people there are, and which zones are occupied.
    """

    def __init__(
        self,
        camera: Camera,
        outbox: Outbox,
        receivers: Sequence[str],
        home_assistant: HomeAssistant | None = None,
    ) -> None:
        self._camera, self._outbox, self._receivers = camera, outbox, receivers
        self._home_assistant = home_assistant
        self._presence, self._zones = Presence(), list[str]()
        self._run = uuid.uuid4()
        self._seen: deque[str] = deque(maxlen=_SEEN_EVENTS)
        # Time of the first frame whose answer was lost, and with it perhaps events.
        self._lost_since: float | None = None
        self.answered = 0

    def watch(self, source: Source, fps: float) -> None:
        """Post frames until a file ends; raise if the service will accept none."""
        status_at = time.monotonic()
        for frame in source.frames():
            began = time.monotonic()
            answer = self._track(frame)
            if answer is not None and began >= status_at:
                status_at = began + STATUS_EVERY_S
                say(f"{status(answer)}; {self.answered} of {frame.number + 1} frames")
                self._read_zones()
            time.sleep(max(0.0, began + 1 / fps - time.monotonic()))
        say(f"the end: {self.answered} frames were answered")

    def _track(self, frame: Frame) -> dict[str, Any] | None:
        """Post a frame and pass its events on; None if the service does not take it."""
        try:
            is_new, answer = self._camera.track(frame)
            if self._lost_since is not None:
                answer["events"] = self._events_since(self._lost_since)
        except (OSError, http.client.HTTPException) as error:
            wait_s = service.RETRY_AFTER_S
            say(f"the service does not answer ({error}); trying again in {wait_s:g} s")
        except RefusedError as refusal:
            if refusal.status not in _PASSING:
                raise
            wait_s = refusal.retry_after_s
            say(f"{refusal}; trying again in {wait_s:g} s")
        else:
            self._lost_since = None
            self._hand_on(is_new, answer)
            return answer
        if self._lost_since is None:
            self._lost_since = frame.timestamp
        time.sleep(wait_s)
        return None

    def _events_since(self, timestamp: float) -> list[Event]:
        # The service rounds timestamps.
        return [e for e in self._camera.events() if e["timestamp"] >= timestamp - 1e-3]

    def _hand_on(self, is_new: bool, answer: Mapping[str, Any]) -> None:
        if is_new and self.answered:
            say("the service had forgotten this camera: people are numbered anew")
        if answer["reset"]:
            say(f"people are followed anew: {answer['reset']}")
        first = is_new or not self.answered
        self.answered += 1
        for event in answer["events"]:
            message = self._message(event)
            if message["id"] not in self._seen:
                self._seen.append(message["id"])
                self._outbox.put(self._receivers, message)
                print(json.dumps(message), flush=True)
                self._presence.update(event)
        if first:
            self._presence.begin(answer["persons"])
        self._show()

    def _message(self, event: Event) -> dict[str, Any]:
        """An event with the camera, the time of day, and a unique id."""
        moment = datetime.fromtimestamp(event["timestamp"], UTC).isoformat(timespec="milliseconds")
        event_id = uuid.uuid5(self._run, json.dumps(event, sort_keys=True))
        camera_id = self._camera.camera_id
        return {"id": str(event_id), "camera_id": camera_id, "time": moment, **event}

    def _read_zones(self) -> None:
        try:
            self._zones = self._camera.zones()
        except (OSError, http.client.HTTPException, RefusedError):
            return  # The next frame says what is wrong.
        self._show()

    def _show(self) -> None:
        if self._home_assistant is not None:
            self._home_assistant.show(self._presence, self._zones)


def status(answer: Mapping[str, Any]) -> str:
    """Return the people of an answer, and how long the service took."""
    people = ", ".join(
        f"{person['track_id']} {(person['posture'] or {'label': 'unclear'})['label']}"
        for person in answer["persons"]
    )
    return f"{people or 'no people'}; {answer['timings_ms']['total']:.0f} ms"


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch as the command line asks."""
    options = _options(arguments)
    home_assistant = _home_assistant(options)
    senders: dict[str, Callable[[Message], None]] = {}
    if options.webhook:
        senders["webhook"] = Webhook(options.webhook).send
    if home_assistant is not None:
        senders["mqtt"] = home_assistant.send
    outbox, stopping = Outbox(options.queue), threading.Event()
    for receiver, send in senders.items():
        work = (outbox, receiver, send, stopping)
        threading.Thread(target=deliver, args=work, daemon=True).start()
    camera = Camera(options.url, options.camera_id, options.api_key)
    bridge = Bridge(camera, outbox, tuple(senders), home_assistant)
    try:
        _watch(bridge, outbox, options)
    except RefusedError as refusal:
        print(f"watch-camera: the service refuses: {refusal}", file=sys.stderr)
        return 1
    finally:
        stopping.set()
        if home_assistant is not None:
            home_assistant.close()
    if len(outbox):
        where = f"wait in {options.queue}" if options.queue else "are lost: --queue would keep them"
        say(f"{len(outbox)} deliveries {where}")
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; end the program if it cannot be followed."""
    parser = argparse.ArgumentParser(description="A camera's frames to a service, events from it.")
    parser.add_argument("source", help="file, number of a device, or URL of a stream")
    parser.add_argument("camera_id", help="name of the camera for the service")
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the service")
    parser.add_argument("--fps", type=float, default=10.0, help="frames a second at most")
    parser.add_argument("--api-key", default=os.environ.get("WATCH_API_KEY"), help="of the service")
    parser.add_argument("--webhook", metavar="URL", help="where events are posted")
    parser.add_argument(
        "--mqtt",
        metavar="URL",
        default=os.environ.get("WATCH_MQTT"),
        help="broker, mqtt://[user:password@]host[:port] or mqtts://",
    )
    parser.add_argument("--queue", metavar="FILE", type=Path, help="keeps events that wait")
    options = parser.parse_args(arguments)
    source = str(options.source)
    if not (source.isdecimal() or "://" in source or Path(source).is_file()):
        parser.error(f"source: expected a file, a number or a URL, got {source}")
    for name, schemes in (("webhook", ("http", "https")), ("mqtt", ("mqtt", "mqtts"))):
        url = getattr(options, name)
        if url is not None and url.partition("://")[0] not in schemes:
            parser.error(f"--{name}: expected {schemes[0]}:// or {schemes[1]}://, got {url}")
    if options.mqtt and importlib.util.find_spec("paho") is None:
        parser.error("--mqtt: expected the package paho-mqtt: pip install paho-mqtt")
    return options


def _home_assistant(options: argparse.Namespace) -> HomeAssistant | None:
    """Connect to the broker, if there is one; the only place that needs paho-mqtt."""
    if not options.mqtt:
        return None
    from scripts.watch_camera.home_assistant import HomeAssistant

    return HomeAssistant(options.mqtt, options.camera_id)


def _watch(bridge: Bridge, outbox: Outbox, options: argparse.Namespace) -> None:
    """Watch until a file ends or the program is stopped; then wait for deliveries."""
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        bridge.watch(Source(options.source), options.fps)
        outbox.wait_until_empty()
    except KeyboardInterrupt:
        say("stopped")
        outbox.wait_until_empty(STOPS_WITHIN_S)
