"""The cameras of a service: their settings, and sessions within limits of number and memory."""

import json
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from app.camera import CameraSession
from app.configuration import CameraConfiguration
from app.configuration import Zone as ConfiguredZone
from app.estimation.results import Evidence
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.results import Event, TrackedFrame
from app.tracking.zones import Zone
from app.vision.optics import Optics

EndReason = Literal["forgotten", "idle", "number", "memory", "index"]
"""Why a session ended: on demand, by one of the limits, or because the index was replaced."""


class CameraKey(NamedTuple):
    """Identifies a session: callers do not see one another's cameras."""

    caller: int
    camera_id: str


@dataclass(frozen=True)
class CameraTraffic:
    """Seconds since a camera's last answered frame, and the frames refused since, by reason."""

    key: CameraKey
    idle_s: float
    dropped: Mapping[str, int]


class NoSessionsError(ValueError):
    """The service keeps no camera sessions."""


class UnknownCameraError(KeyError):
    """A camera has neither a session nor settings; the argument is its name."""


class UnknownEventError(KeyError):
    """A camera lists no such event, or one that concerns no person; the argument is its id."""


class TooManyCamerasError(ValueError):
    """A caller has configured as many cameras as allowed, all of which have sent frames."""


class ImageSize(NamedTuple):
    """Columns and rows of a frame."""

    width: int
    height: int


@dataclass(frozen=True)
class SessionSummary:
    """A camera session at a glance: its last frame, in seconds, and its people.

    ``age_s`` and ``idle_s`` are the seconds since the first and since the last frame came.
    """

    frames: int
    timestamp: float
    image: ImageSize
    track_ids: tuple[int, ...]
    age_s: float
    idle_s: float
    memory_bytes: int


_NO_SETTINGS = CameraConfiguration.model_validate({})


def _with_optics(upload: Upload, given: CameraConfiguration) -> Upload:
    """An upload with missing optics filled in from those of its camera."""
    optics = Optics(given.fov_deg, given.pixel_aspect, given.roll_deg)
    return replace(upload, optics=upload.optics.or_else(optics))


class Wanted(NamedTuple):
    """Hypotheses of each person, what they are estimated from, and whether silhouettes are drawn.

    See :meth:`app.camera.CameraSession.process`.
    """

    n: int
    evidence: Evidence = "photograph"
    drawn: bool = True


class SessionLimits(NamedTuple):
    """Most sessions, their longest time without a frame, and most memory of all together."""

    sessions: int
    idle_s: float
    memory_bytes: int


@dataclass(frozen=True)
class CameraSummary:
    """A camera that has a session or settings."""

    camera_id: str
    settings: CameraConfiguration
    session: SessionSummary | None


def _id_of(event: Event, key: CameraKey) -> str:
    """The id of an event, the same whenever it is listed; no other event of any camera has it."""
    facts = event.event, event.state, event.track_id, event.zones, event.timestamp
    return str(uuid.uuid5(uuid.NAMESPACE_OID, json.dumps([key.camera_id, *facts])))


class _OpenSession:
    """A session, and a summary that threads other than the session's own may read."""

    def __init__(self, session: CameraSession, estimator: Estimator, now: float) -> None:
        self.session = session
        self.estimator = estimator
        self.busy = True
        self.dropped: Counter[str] = Counter()
        self._first = self.last = now

    def note(self, frame: TrackedFrame, now: float) -> None:
        """Summarise the newest frame."""
        height, width = frame.frame.shape[:2]
        self.last = now
        self.memory_bytes = self.session.memory_bytes
        self._newest = SessionSummary(
            frames=frame.frame_index + 1,
            timestamp=frame.timestamp,
            image=ImageSize(width, height),
            track_ids=tuple(person.track_id for person in frame.persons),
            age_s=now - self._first,
            idle_s=0.0,
            memory_bytes=self.memory_bytes,
        )

    def summary(self, now: float) -> SessionSummary:
        return replace(self._newest, age_s=now - self._first, idle_s=now - self.last)


class CameraSessions:
    """Camera sessions, bounded in number, memory and idle time; safe under several threads.

    Where a limit is exceeded, the caller with the most sessions loses the least recently used one,
    so that nobody crowds out others. A session whose frame is being processed stays, and so does
    the last used one even if it alone exceeds the memory. Settings outlive a session that ends by a
    limit, until they are replaced or the camera is forgotten.

    Limits are for all callers together, but each may configure as many cameras. The settings
    ``configured`` by name apply to all callers until one sets its own. ``on_change`` is called when
    a session has begun, with None, or ended.
    """

    def __init__(
        self,
        create: Callable[[Estimator], CameraSession],
        limits: SessionLimits,
        configured: Mapping[str, CameraConfiguration],
        on_change: Callable[[EndReason | None], None] = lambda reason: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._create, self._limits, self._configured = create, limits, configured
        self._on_change, self._clock = on_change, clock
        self._open: dict[CameraKey, _OpenSession] = {}
        self._settings: dict[CameraKey, CameraConfiguration] = {}
        self._events: dict[CameraKey, deque[Event]] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._open)

    def __contains__(self, key: object) -> bool:
        with self._lock:
            self._end_idle()
            return key in self._open

    def process(
        self,
        key: CameraKey,
        estimator: Estimator,
        upload: Upload,
        timestamp: float | None,
        job: Job,
        wanted: Wanted,
    ) -> TrackedFrame:
        """Process the next frame of a camera; its session begins if there is none.

        Only a usable frame begins a session, so an unusable one displaces none. Frames of one
        camera must not be processed at the same time, which
        :meth:`app.scheduling.executor.Executor.run` prevents. A session that was begun with
        another estimator ends: its tracks hold poses of another index. Raises as
        :meth:`app.camera.CameraSession.process` does.
        """
        with self._lock:
            self._end_idle()
            opened = self._open.get(key)
            if opened is not None and opened.estimator is not estimator:
                self._end(key, "index")
                opened = None
            if opened is not None:
                opened.busy = True
            settings = self._settings_of(key)
        begins = opened is None
        if opened is None:
            opened = _OpenSession(self._create(estimator), estimator, self._clock())
        try:
            opened.session.zones = [
                Zone(one.name, one.kind, np.array(one.polygon)) for one in settings.zones
            ]
            frame = opened.session.process(
                _with_optics(upload, settings),
                timestamp,
                wanted.n,
                job,
                wanted.evidence,
                drawn=wanted.drawn,
            )
            raised = tuple(
                replace(one, id=_id_of(one, key))
                for one in frame.events
                if settings.raises(one.event)
            )
            frame = replace(frame, events=raised)
            with self._lock:
                opened.note(frame, self._clock())
                if begins:
                    self._open[key] = opened
                    self._on_change(None)
                # Unless the camera was forgotten meanwhile.
                if self._open.get(key) is opened:
                    # For each camera.
                    self._events.setdefault(key, deque(maxlen=100)).extend(frame.events)
                self._shrink()
        finally:
            opened.busy = False
        return frame

    def check_kept(self) -> None:
        """Raise NoSessionsError if there may be no sessions."""
        if not self._limits.sessions:
            raise NoSessionsError("this service keeps no camera sessions")

    def configure(self, key: CameraKey, settings: CameraConfiguration) -> CameraSummary:
        """Set zones, optics and events of a camera, from its next frame on.

        If the caller has settings for as many other cameras as there may be sessions, the one that
        was configured longest ago of those that have sent no frame is forgotten; if all of them
        have, TooManyCamerasError is raised. Raises as `check_kept` does, too.
        """
        self.check_kept()
        with self._lock:
            others = [k for k in self._settings if k.caller == key.caller and k != key]
            matters = settings != _NO_SETTINGS or key.camera_id in self._configured
            if matters and len(others) >= self._limits.sessions:
                unused = next((k for k in others if k not in self._events), None)
                if unused is None:
                    most = f"{self._limits.sessions} cameras with zones or optics"
                    sentence = f"expected at most {most}, got one more; forget one first"
                    raise TooManyCamerasError(sentence)
                del self._settings[unused]
            self._settings.pop(key, None)  # So that the newest is the last.
            if matters:
                self._settings[key] = settings
            self._drop_events()
            return self._summary(key)

    def summaries(self, caller: int) -> list[CameraSummary]:
        """Return the summaries of a caller's cameras, ordered by name."""
        with self._lock:
            self._end_idle()
            known = self._open.keys() | self._settings.keys()
            known |= {CameraKey(caller, name) for name in self._configured}
            return [self._summary(key) for key in sorted(known) if key.caller == caller]

    def summary(self, key: CameraKey) -> CameraSummary:
        """Return the summary of a camera; raises UnknownCameraError if there is none."""
        with self._lock:
            self._check_known(key)
            return self._summary(key)

    def events(self, key: CameraKey) -> tuple[Event, ...]:
        """Return the latest events of a camera, oldest first; raises as `summary` does."""
        with self._lock:
            self._check_known(key)
            return tuple(self._events.get(key, ()))

    def replay(self, key: CameraKey, event_id: str) -> tuple[Event, list[ConfiguredZone]]:
        """Return an event with its replay, which may still grow, and the camera's zones.

        Raises UnknownEventError if there is none, or as `summary` does.
        """
        for event in self.events(key):
            if event.id == event_id and event.replay is not None and event.replay.moments:
                return event, self._settings_of(key).zones
        raise UnknownEventError(event_id)

    def count_dropped(self, key: CameraKey, reason: str) -> None:
        """Count a refused frame of a camera, if it has a session."""
        with self._lock:
            if key in self._open:
                self._open[key].dropped[reason] += 1

    def traffic(self) -> list[CameraTraffic]:
        """Return the traffic of all cameras that have a session."""
        with self._lock:
            self._end_idle()
            now = self._clock()
            return [
                CameraTraffic(key, now - opened.last, dict(opened.dropped))
                for key, opened in self._open.items()
            ]

    def forget(self, key: CameraKey) -> None:
        """Forget a camera's session, events and the caller's settings; raises as `summary` does.

        Settings given at startup apply again. A frame already being processed is completed.
        """
        with self._lock:
            self._check_known(key)
            self._settings.pop(key, None)
            self._events.pop(key, None)
            if key in self._open:
                self._end(key, "forgotten")

    def end_others(self, estimator: Estimator) -> None:
        """End the sessions of all other estimators, which would otherwise stay in memory."""
        with self._lock:
            for key, opened in list(self._open.items()):
                if opened.estimator is not estimator and not opened.busy:
                    self._end(key, "index")

    def end_idle(self) -> None:
        """End the sessions whose last frame came too long ago."""
        with self._lock:
            self._end_idle()

    def _check_known(self, key: CameraKey) -> None:
        self._end_idle()
        if not self._is_known(key):
            raise UnknownCameraError(key.camera_id)

    def _is_known(self, key: CameraKey) -> bool:
        return key in self._open or key in self._settings or key.camera_id in self._configured

    def _settings_of(self, key: CameraKey) -> CameraConfiguration:
        configured = self._configured.get(key.camera_id, _NO_SETTINGS)
        return self._settings.get(key, configured)

    def _drop_events(self) -> None:
        """Drop the events of cameras that are no longer known."""
        for key in [key for key in self._events if not self._is_known(key)]:
            del self._events[key]

    def _summary(self, key: CameraKey) -> CameraSummary:
        opened = self._open.get(key)
        session = opened.summary(self._clock()) if opened else None
        return CameraSummary(key.camera_id, self._settings_of(key), session)

    def _end_idle(self) -> None:
        since = self._clock() - self._limits.idle_s
        for key, opened in list(self._open.items()):
            if opened.last < since and not opened.busy:
                self._end(key, "idle")

    def _shrink(self) -> None:
        """End sessions until the limits hold or all others are busy."""
        while len(self._open) > self._limits.sessions and self._end_oldest("number"):
            pass
        while self._memory_bytes() > self._limits.memory_bytes and self._end_oldest("memory"):
            pass

    def _memory_bytes(self) -> int:
        return sum(opened.memory_bytes for opened in self._open.values())

    def _end_oldest(self, reason: EndReason) -> bool:
        idle = {key: opened for key, opened in self._open.items() if not opened.busy}
        if not idle:
            return False
        callers = [key.caller for key in self._open]
        self._end(min(idle, key=lambda k: (-callers.count(k.caller), idle[k].last)), reason)
        return True

    def _end(self, key: CameraKey, reason: EndReason) -> None:
        del self._open[key]
        self._drop_events()
        self._on_change(reason)
