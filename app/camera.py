"""A camera session: frames of one fixed camera, in order, to people with identities."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.decoding import MIN_STEP_S
from app.estimation.results import Evidence, Person
from app.estimation.upload import DecodedUpload, Upload
from app.photograph import Estimator
from app.scene import Patch, View
from app.scheduling.job import Job
from app.tracking.floor import Floor
from app.tracking.following import TrackedPeopleDetector
from app.tracking.replay import Recorder
from app.tracking.results import Event, EventState, TrackedFrame, TrackedPerson
from app.tracking.track import Track, Tracks, associate
from app.tracking.zones import Zone, is_outside
from app.vision.halved import Frame
from app.vision.images import ImageWarning
from app.vision.optics import Optics, PinholeCamera, Rectification
from app.vision.same_person import colours_of
from index.matching import DEFAULT_HYPOTHESES

TRACK_BYTES = 145_000
"""Memory of a track that is a few seconds long, without the outline; 15 kB are for replays."""

# After a longer gap the scene may be another one.
_MAX_GAP_S = 10.0


class LateFrameError(ValueError):
    """A frame is not later than the one before."""


@dataclass(frozen=True)
class _Shown:
    """A frame as sent, its camera and the warnings about it."""

    frame: NDArray[np.uint8]
    camera: PinholeCamera
    warnings: tuple[ImageWarning, ...]


@dataclass(frozen=True)
class _EmptyScene:
    """A camera whose previous frame showed no person: that frame's shape, and the optics."""

    shape: tuple[int, ...]
    optics: Optics

    def shown(self, zones: Sequence[Zone]) -> _Shown:
        """The next frame, if it shows the same scene; its pixels are not needed and stay black."""
        black = np.broadcast_to(np.zeros(1, np.uint8), self.shape)
        camera = PinholeCamera.of_frame(self.shape, self.optics.fov_deg)
        return _Shown(black, camera, _warnings(zones, self.shape))


def _warnings(zones: Sequence[Zone], shape: tuple[int, ...]) -> tuple[ImageWarning, ...]:
    """Warnings about the zones of a frame."""
    return ("zone_outside",) if any(is_outside(one.polygon, shape) for one in zones) else ()


class CameraSession:
    """Frames of one fixed camera; takes one at a time.

    Memory is bounded by the number of tracks, at most twice the number of people in a frame.

    Parameters
    ----------
    estimator : Estimator
        Finds people and estimates their poses.
    clock : callable
        Seconds, for frames without a timestamp.

    Examples
    --------
    >>> from pathlib import Path
    >>> from app import CameraSession, Upload, load_estimator
    >>> session = CameraSession(load_estimator())
    >>> walkers = Upload(Path("tests/data/walkers.jpg").read_bytes())
    >>> [event.event for event in session.process(walkers, timestamp=0.0, n=0).events]
    ['entered', 'entered', 'entered', 'entered', 'entered']
    >>> sorted(one.track_id for one in session.process(walkers, timestamp=0.1, n=0).persons)
    [1, 2, 3, 4, 5]
    """

    def __init__(self, estimator: Estimator, clock: Callable[[], float] = time.monotonic) -> None:
        self.zones: Sequence[Zone] = ()
        """In pixels of the frame as sent; they may change between frames."""
        self._estimator = estimator
        self._clock = clock
        self._detector = TrackedPeopleDetector(estimator.finder)
        self._view, self._floor = View(), Floor()
        self._recorder = Recorder()
        self._tracks = Tracks(2 * estimator.finder.max_persons)
        self._frames = 0
        self._rectification: Rectification | None = None
        self._asked: tuple[int, Optics] | None = None
        """Hypotheses and optics for which people were estimated."""
        self._timestamp = -math.inf
        self._arrived = 0.0
        self._empty: _EmptyScene | None = None
        # Events not reported yet, since a frame may fail half-way.
        self._reset: str | None = None
        self._events: list[Event] = []

    @property
    def memory_bytes(self) -> int:
        """Approximate memory used by the session."""
        return sum(TRACK_BYTES + track.last_estimate.outline_bytes for track in self._tracks)

    def process(
        self,
        upload: Upload,
        timestamp: float | None = None,
        n: int = DEFAULT_HYPOTHESES,
        job: Job | None = None,
        evidence: Evidence = "photograph",
        *,
        drawn: bool = True,
    ) -> TrackedFrame:
        """Find the people of a frame, identify them, and estimate ``n`` hypotheses of their poses.

        If ``n`` is 0, people get no hypotheses and no smooth pose, and only people without
        landmarks are matched; everything else is the same as for other ``n``. The timestamp is in
        seconds; without one, the session's clock gives the time since the frame before. If the job
        raises, the next frame reports the events of this one. ``evidence`` is that of
        :meth:`app.photograph.Estimator.estimate`. Unless silhouettes are to be ``drawn`` in every
        frame, that of a person who is surely read is drawn and matched every 0.4 s; in between, it
        and the hypotheses move along with the landmarks.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        LateFrameError
            If the timestamp is not after that of the frame before. If it is earlier by more than a
            late frame can be, the session starts afresh instead.
        """
        job = job or Job()
        evidence = self._estimator.evidence(evidence)
        arrived = self._clock()
        timestamp = self._time_of(timestamp, arrived)
        empty = self._still_empty(upload, timestamp, evidence, job)
        if empty is not None:
            self._watch(timestamp, empty.shape)
            return self._answered(empty.shown(self.zones), timestamp, arrived, (), job)
        half_of = self._halved_shape(upload, evidence)
        decoded = self._estimator.decode(upload, job, half_of=half_of)
        frame, rectification = decoded.frame, decoded.rectification
        warnings = (*decoded.warnings, *_warnings(self.zones, decoded.sent.shape))
        zones = [replace(zone, polygon=rectification.points(zone.polygon)) for zone in self.zones]
        self._start_afresh_if_needed(rectification, timestamp)
        if self._asked != (n, upload.optics):
            self._asked = n, upload.optics
            for track in self._tracks:
                track.last_estimate.forget()
        people, in_window = self._find(decoded, evidence, timestamp, job, drawn=drawn)
        if decoded.has_frame:
            people = [_with_looks(person, frame) for person in people]
        if upload.track_ids is None:
            known = associate(self._tracks, people, timestamp, in_window)
        else:
            known = self._tracks.named_by_caller(people, upload.track_ids, timestamp)
        seen = self._tracks.see(people, known, timestamp)
        self._events += self._tracks.confirm(timestamp, zones)
        self._events += self._tracks.drop_unseen(frame, timestamp)
        seen += self._tracks.hidden_people(frame.shape, timestamp)
        confirmed = [(person, track) for person, track in seen if track.track_id is not None]
        confirmed.sort(key=lambda pair: pair[0].box.x)
        tracked = self._with_poses(confirmed, decoded, timestamp, n, zones, job)
        if job.left_out:
            warnings = ("crowded", *warnings)
        shown = _Shown(decoded.sent, rectification.camera_sent(decoded.camera), warnings)
        self._empty = self._as_empty(decoded, upload.optics)
        persons = tuple(_as_sent(person, rectification) for person in tracked)
        return self._answered(shown, timestamp, arrived, persons, job)

    def _as_empty(self, decoded: DecodedUpload, optics: Optics) -> _EmptyScene | None:
        """The scene of a frame as sent, if it shows no person."""
        if self._tracks or decoded.warnings or decoded.rectification.changes:
            return None
        return _EmptyScene(decoded.sent.shape, optics)

    def _still_empty(
        self, upload: Upload, timestamp: float, evidence: Evidence, job: Job
    ) -> _EmptyScene | None:
        """The empty scene of the frame before, if the file of this one shows the same."""
        data, empty = upload.frame, self._empty
        if (
            empty is None
            or upload.optics != empty.optics
            or not _is_photograph_alone(upload, evidence)
            or not isinstance(data, bytes)
            or self._reset
            or not 0 <= timestamp - self._timestamp <= _MAX_GAP_S
        ):
            return None
        with job.stage("decode"):
            if not self._detector.shows_nothing_new(data, empty.shape, timestamp):
                return None
        job.checkpoint()
        return empty

    def _halved_shape(self, upload: Upload, evidence: Evidence) -> tuple[int, ...] | None:
        """The shape of the frame before, if half the size of such a frame shows all its people."""
        before = self._rectification
        if before is None or not _is_photograph_alone(upload, evidence):
            return None
        shape = (*before.sent, 3)
        return shape if self._detector.half_suffices(shape, self._tracks) else None

    def _answered(
        self,
        shown: _Shown,
        timestamp: float,
        arrived: float,
        persons: tuple[TrackedPerson, ...],
        job: Job,
    ) -> TrackedFrame:
        """Finish a frame and report its events.

        The time is stored only now, so that a frame that failed half-way may be sent again.
        """
        self._timestamp, self._arrived = timestamp, arrived
        self._frames += 1
        reset, self._reset = self._reset, None
        events, self._events = self._events, []
        self._recorder.add(timestamp, {one.track_id: one for one in persons})
        for number, event in enumerate(events):
            if event.track_id is not None:
                replay = self._recorder.begin(event.track_id, timestamp, shown.frame.shape)
                events[number] = replace(event, replay=replay)
        obstructed: tuple[ImageWarning, ...] = ("obstructed",) if self._view.blocked.holds else ()
        return TrackedFrame(
            frame=shown.frame,
            camera=shown.camera,
            warnings=(*shown.warnings, *obstructed),
            frame_index=self._frames - 1,
            timestamp=timestamp,
            session="new" if self._frames == 1 else "warm",
            reset=reset,
            persons=persons,
            events=tuple(events),
            timings_ms=job.timings_ms(),
        )

    def unconfirmed(self) -> list[Event]:
        """Events that had begun to show at the last frame but were not certain."""
        events = [event for track in self._tracks for event in track.unconfirmed()]
        if self._view.blocked.is_unconfirmed:
            events.append(self._obstructed("unconfirmed", self._view.last_at or 0.0))
        return events

    def _obstructed(self, state: EventState, timestamp: float) -> Event:
        return Event("obstructed", state, timestamp, self._view.blocked.level)

    def _time_of(self, timestamp: float | None, arrived: float) -> float:
        if timestamp is None:
            if self._frames == 0:
                return 0.0
            return self._timestamp + max(MIN_STEP_S, arrived - self._arrived)
        # A frame that is late by more than this was not overtaken by another one: the clock was
        # set, or an earlier timestamp was wrong.
        begins_afresh = timestamp < self._timestamp - 5.0
        if not (begins_afresh or timestamp >= self._timestamp + MIN_STEP_S):
            raise LateFrameError(
                f"expected a timestamp after {self._timestamp:.15g} s, that of the camera's "
                f"last frame, got {timestamp:.15g} s"
            )
        return timestamp

    def _start_afresh_if_needed(self, now: Rectification, timestamp: float) -> None:
        """Drop all tracks if the frame cannot continue the previous ones."""
        before, self._rectification = self._rectification, now
        gap = timestamp - self._timestamp
        if before is None:
            self._tracks.watched_from = timestamp
            return
        is_same_view = (before.square, before.roll_deg) == (now.square, now.roll_deg)
        if before.square != now.square:
            (height, width), (rows, columns) = before.square, now.square
            reason = f"frames were {width}x{height} pixels before, this one is {columns}x{rows}"
        elif before.roll_deg != now.roll_deg:
            reason = f"roll_deg was {before.roll_deg} before, it is {now.roll_deg} now"
        elif self._frames and gap > _MAX_GAP_S:
            reason = f"no frame came for {gap:.1f} s, more than {_MAX_GAP_S:g} s"
        elif self._frames and gap < 0:
            reason = f"the timestamps went back by {-gap:.1f} s"
        else:
            return
        self._reset, self._tracks.watched_from = reason, timestamp
        self._detector = TrackedPeopleDetector(self._estimator.finder)
        if not is_same_view:
            if self._view.blocked.holds:
                self._events.append(self._obstructed("end", timestamp))
            self._view, self._floor = View(), Floor()
        self._events += self._tracks.end(timestamp)

    def _find(
        self, decoded: DecodedUpload, evidence: Evidence, timestamp: float, job: Job, *, drawn: bool
    ) -> tuple[list[Person], dict[int, Track]]:
        """Find people, in the windows of tracks as well unless the caller marks the people.

        Also returns the track for the position of each person found in a track's window.
        """
        shown = decoded.mask, decoded.boxes, decoded.background
        reads = decoded.has_frame and evidence == "photograph"
        if reads and all(one is None for one in shown):
            people, in_window = self._detector.find(
                decoded, timestamp, self._tracks, job, drawn=drawn
            )
            self._watch(timestamp, decoded.frame.shape, people)
            return people, in_window
        return self._estimator.finder.find(decoded, evidence, job), {}

    def _watch(
        self, timestamp: float, shape: tuple[int, ...], people: Sequence[Person] = ()
    ) -> None:
        """Watch whether the view of frames of this shape is blocked; people do not count."""
        grey = self._detector.scene.now
        if grey is not None:
            places = [one.box.scaled(grey.shape[0] / shape[0]) for one in people]
            if change := self._view.update(timestamp, grey, places):
                self._events.append(self._obstructed(change, timestamp))
        if self._view.blocked.holds:
            self._floor.forget()  # The camera may have been turned.

    def _with_poses(
        self,
        seen: list[tuple[Person, Track]],
        upload: DecodedUpload,
        timestamp: float,
        n: int,
        zones: Sequence[Zone],
        job: Job,
    ) -> tuple[TrackedPerson, ...]:
        """Estimate the poses of people with a silhouette, and update their tracks."""
        # Unchanged people have their hypotheses already.
        fits = [not person.hypotheses and (n > 0 or person.landmarks is None) for person, _ in seen]
        wanted = [
            replace(person, matched=track.last_estimate.matched) if person.moved_along else person
            for (person, track), one in zip(seen, fits, strict=True)
            if one
        ]
        count = max(n, DEFAULT_HYPOTHESES)
        fitted = iter(self._estimator.fit(wanted, upload.camera, count, job))
        self._floor.watch(upload.camera)
        tracked = []
        for (person, track), one in zip(seen, fits, strict=True):
            if one:
                person = next(fitted) or person
            result, events = track.update(
                person,
                timestamp,
                zones,
                frame=upload.frame,
                covered=track.place.covered_share(
                    person.box, self._tracks.named_places(), timestamp
                ),
                floor=self._floor,
            )
            self._events += events
            tracked.append(replace(result, hypotheses=result.hypotheses[:n]))
        if not n:
            tracked = [replace(one, pose=None) for one in tracked]
        return tuple(tracked)


def _is_photograph_alone(upload: Upload, evidence: Evidence) -> bool:
    return upload.given == ("frame",) and evidence == "photograph"


def _as_sent(tracked: TrackedPerson, rectification: Rectification) -> TrackedPerson:
    """A tracked person in pixels and axes of the frame as sent."""
    pose = tracked.pose and replace(
        tracked.pose,
        points_2d=rectification.points_sent(tracked.pose.points_2d),
        points_3d=rectification.axes_sent(tracked.pose.points_3d),
    )
    return replace(tracked.as_sent(rectification), pose=pose)


def _with_looks(person: Person, frame: Frame) -> Person:
    """A person with the picture of their place and the colours of their clothes."""
    if person.patch is not None:
        return person  # It is unchanged.
    silhouette = None if person.moved_along else person.silhouette
    colours = None if silhouette is None else colours_of(frame, silhouette)
    return replace(person, patch=Patch.of(frame, person.box), colours=colours)
