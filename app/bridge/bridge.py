"""Frames of a camera to a service, its events to an outbox, its people to Home Assistant."""

import contextlib
import json
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from app.bridge import RETRY_AFTER_S, RefusedError, Trouble, UnavailableError, say
from app.bridge.home_assistant import HomeAssistant
from app.bridge.outbox import Message, Outbox
from app.bridge.source import Source
from app.bridge.web import Camera
from app.decoding import Frame

# Time without a sighting after which a person is gone; a session looks for nobody longer.
HELD_S = 2.0
_NO_KEY = (401, 403)
# These end the bridge before a frame was answered: the set-up is wrong. Later, it may recover.
_NO_CAMERA = (404, 405, 422)


class Seen(NamedTuple):
    """Where and when a person was last seen."""

    timestamp: float
    zones: Sequence[str]
    posture: str


def presence(
    before: Mapping[int, Seen], answer: Mapping[str, Any], *, anew: bool = False
) -> dict[int, Seen]:
    """Return the people before a camera by identity: those before, and those of a frame's answer.

    Events say less: a camera may be set to raise only some. A person whom frames do not show stays
    for :data:`HELD_S`, or until ``left`` is raised; ``anew`` says that identities begin anew.
    """
    now = answer["timestamp"]
    left = {one["track_id"] for one in answer["events"] if one["event"] == "left"}
    held = {} if anew or answer["reset"] else before
    people = {n: one for n, one in held.items() if n not in left and now - one.timestamp <= HELD_S}
    for one in answer["persons"]:
        people[one["track_id"]] = Seen(now, one["zones"], _posture(one))
    return people


class Bridge:
    """Posts a camera's frames, passes the events on, and shows Home Assistant what there is."""

    def __init__(
        self,
        camera: Camera,
        outbox: Outbox,
        home_assistant: HomeAssistant | None = None,
        *,
        ends_if_refused: bool = False,
    ) -> None:
        self._camera, self._outbox, self._home_assistant = camera, outbox, home_assistant
        self._ends_if_refused = ends_if_refused
        self._people: dict[int, Seen] = {}
        self._obstructed = False
        self._zones: list[str] | None = None  # Not known before the service has named them.
        self._raises_left = True
        self._trouble = Trouble("the service answers again")
        self._is_configured = False
        self._not_set = Trouble("the service takes zones and optics")
        # Whether the service may list events that were not passed on.
        self._missed_events = True
        self.answered = 0

    def watch(self, source: Source, fps: float, stopping: threading.Event) -> None:
        """Post frames until a file ends or this is stopped.

        With ``ends_if_refused``, raises RefusedError if none is taken.
        """
        status_at = time.monotonic()
        with contextlib.suppress(UnavailableError, RefusedError):  # The first frame meets the same.
            self._configure()
            self._catch_up()
        for frame in source.frames(stopping):
            began = time.monotonic()
            answer, wait_s = self._track(frame)
            if answer is not None and began >= status_at:
                status_at = began + 10.0
                say(f"{status(answer)}; {self.answered} of {frame.number + 1} frames")
                self._read_settings()
            stopping.wait(max(wait_s, began + 1 / fps - time.monotonic()))
        say(f"the end: {self.answered} frames were answered")

    def _track(self, frame: Frame) -> tuple[dict[str, Any] | None, float]:
        """Return the answer to a frame, None if there is none, and the seconds to wait."""
        try:
            if self._missed_events or not self._is_configured:
                self._configure()
            if self._missed_events:
                self._catch_up()
            self._missed_events = True
            is_new, answer = self._camera.track(frame)
        except UnavailableError as error:
            self._trouble.report(f"the service does not answer: {error}")
            return None, RETRY_AFTER_S
        except RefusedError as refusal:
            is_lasting = refusal.status in (_NO_KEY if self.answered else _NO_KEY + _NO_CAMERA)
            if is_lasting and self._ends_if_refused:
                raise
            wait_s = self._trouble.report(f"the service does not take a frame: {refusal}")
            return None, wait_s if is_lasting else refusal.retry_after_s
        self._missed_events = False
        self._trouble.end()
        self._hand_on(is_new, answer)
        return answer, 0.0

    def _configure(self) -> None:
        """Tell the service about the camera, of which it may know nothing."""
        try:
            self._camera.configure()
        except RefusedError as refusal:
            if refusal.status in _NO_KEY:
                raise
            self._not_set.report(f"the service does not take zones and optics: {refusal}")
        else:
            self._not_set.end()
        self._is_configured = True

    def _catch_up(self) -> None:
        """Pass on the events that the service lists after the newest that was passed on."""
        messages = [self._message(event) for event in self._camera.events()]
        ids = [message["id"] for message in messages]
        newest = self._outbox.newest
        if newest is None:
            # What happened before the first start is not reported.
            self._outbox.begin_after(ids[-1] if ids else "")
        else:
            for message in messages[ids.index(newest) + 1 if newest in ids else 0 :]:
                self._pass_on(message)
        self._missed_events = False

    def _hand_on(self, is_new: bool, answer: Mapping[str, Any]) -> None:
        if is_new and self.answered:
            self._is_configured = False
            say("the service had forgotten this camera: people are numbered anew")
            for track_id in sorted(self._people) if self._raises_left else ():
                self._pass_on(self._message(_left(track_id, answer["timestamp"])))
        if answer["reset"]:
            say(f"people are followed anew: {answer['reset']}")
        for event in answer["events"]:
            self._pass_on(self._message(event))
        self._people = presence(self._people, answer, anew=is_new)
        self._obstructed = "obstructed" in answer["image"]["warnings"]
        self.answered += 1
        self._show()

    def _pass_on(self, message: Message) -> None:
        try:
            # As one piece, since other cameras print, too.
            print(f"{json.dumps(message)}\n", end="", flush=True)
        except OSError as error:  # A file on a full disk, or a pipe that nobody reads.
            say(f"an event was not printed: {error}")
        self._outbox.put(message)

    def _message(self, event: Mapping[str, Any]) -> Message:
        """An event with the camera, the time of day, and where its replay is.

        Its id is that of the service, which has no replay of what the service did not report.
        """
        moment = datetime.fromtimestamp(event["timestamp"], UTC).isoformat(timespec="milliseconds")
        is_of_person = event["track_id"] is not None and "id" in event
        replay = self._camera.replay_url(event["id"]) if is_of_person else None
        known = {"camera_id": self._camera.camera_id, "time": moment, "replay": replay}
        return {"id": str(uuid.uuid4()), **known, **event}

    def _read_settings(self) -> None:
        try:
            self._zones, events = self._camera.settings()
        except (UnavailableError, RefusedError):
            return  # The next frame meets the same.
        self._raises_left = "left" in events
        self._show()

    def _show(self) -> None:
        if self._home_assistant is not None:
            people = self._people.values()
            zones = None
            if self._zones is not None:
                zones = {zone: any(zone in one.zones for one in people) for zone in self._zones}
            postures = {one.posture for one in people}
            self._home_assistant.show(len(people), zones, postures, obstructed=self._obstructed)


def _left(track_id: int, timestamp: float) -> dict[str, Any]:
    """The event of a person whom a restarted service does not know any more."""
    known = {"track_id": track_id, "timestamp": timestamp, "probability": 1.0}
    unknown = {"caller_track_id": None, "dwell_s": None, "lost": False, "on_floor": None}
    return {"event": "left", "state": "instant", "zones": [], **known, **unknown}


def _posture(person: Mapping[str, Any]) -> str:
    return str((person["posture"] or {"label": "unclear"})["label"])


def status(answer: Mapping[str, Any]) -> str:
    """Return the people of an answer, and how long the service took."""
    people = ", ".join(f"{person['track_id']} {_posture(person)}" for person in answer["persons"])
    return f"{people or 'no people'}; {answer['timings_ms']['total']:.0f} ms"
