"""A camera session: frames of one fixed camera, in order, to people with identities."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.estimation.estimator import Estimator
from app.estimation.results import Evidence, ObservedPerson, Scene
from app.estimation.upload import Upload
from app.scheduling.job import Job
from app.tracking.detection import TrackedPeopleDetector
from app.tracking.matching import appearance_histogram, associate
from app.tracking.results import Event, TrackedFrame, TrackedPerson
from app.tracking.track import Sighting, Track
from app.tracking.zones import Zone
from app.vision.geometry import Box
from app.vision.truncation import ends_at_border
from index.parameters import DEFAULT_HYPOTHESES

LEAST_STEP_S = 1e-3
"""Frames less than this apart have no order that a camera could have seen."""

LONGEST_GAP_S = 10.0
"""After a longer gap the session begins anew: the scene may be another."""

FORGOTTEN_AFTER_S = 0.5
"""How long a track lives that nobody is seen of."""

PREDICTED_FOR_S = 2.0
"""How long the place of somebody is predicted who is hidden behind another one, or who vanished
within the picture."""

HIDDEN_FROM = 0.5
"""Share of somebody that another one has to cover to hide them."""

TRACK_BYTES = 100_000
"""Of a track that has been followed for some seconds; a test measures it."""


class LateFrameError(ValueError):
    """A frame is not later than the one before."""


class CameraSession:
    """Frames of one fixed camera; takes one at a time.

    Memory is bounded by the number of tracks, twice that of the people in a frame.

    Parameters
    ----------
    estimator : Estimator
    clock : callable
        Seconds, for frames without a timestamp.
    """

    def __init__(
        self,
        estimator: Estimator,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._estimator = estimator
        self._clock = clock
        self._follower = TrackedPeopleDetector(estimator.finder)
        self.zones: Sequence[Zone] = ()
        """Those of the camera; may be changed between frames."""
        self._tracks: list[Track] = []
        self._given_ids = 0
        self._frames = 0
        self._size: tuple[int, ...] | None = None
        self._timestamp = -math.inf
        self._arrived = 0.0
        # Not told yet.
        self._reset: str | None = None
        self._events: list[Event] = []

    @property
    def frames(self) -> int:
        """Number of frames worked on."""
        return self._frames

    @property
    def track_ids(self) -> tuple[int, ...]:
        """Identities of the people who are tracked, ascending."""
        return tuple(sorted(track.track_id for track in self._tracks if track.track_id is not None))

    @property
    def memory_bytes(self) -> int:
        """About what the session holds."""
        return TRACK_BYTES * len(self._tracks)

    def process(
        self,
        upload: Upload,
        timestamp: float | None,
        n: int,
        job: Job,
        evidence: Evidence = "photograph",
    ) -> TrackedFrame:
        """Find the people of a frame, say who they are, and estimate their poses.

        Parameters
        ----------
        upload : Upload
        timestamp : float or None
            Seconds; None: the time since the frame before, as the session's clock says.
        n : int
            Hypotheses of each person in the result.
        job : Job
            Checked between steps. Where it raises, the next frame reports what began or ended at
            this one.
        evidence : str
            As in :meth:`app.estimation.estimator.Estimator.estimate`.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        LateFrameError
            If the timestamp is not after that of the frame before.
        """
        arrived = self._clock()
        timestamp = self._time_of(timestamp, arrived)
        decoded = self._estimator.decode(upload, job)
        frame = decoded.frame
        self._begin_anew_where_needed(frame.shape, timestamp)
        reads = evidence == "photograph" and upload.frame is not None
        found: list[tuple[ObservedPerson, Track | None]]
        if reads and upload.mask is None and upload.boxes is None and upload.background is None:
            found = self._follower.find(frame, timestamp, self._tracks, job)
        else:
            people = self._estimator.finder.find(decoded, reads, job)
            found = self._named(people, upload.track_ids, timestamp)
        seen = self._identify(frame if upload.frame is not None else None, found, timestamp)
        self._forget_unseen(timestamp)
        tracked = self._with_poses(seen, frame, timestamp, n, job)
        # A frame that failed half-way may be sent again.
        self._timestamp, self._arrived = timestamp, arrived
        self._frames += 1
        reset, self._reset = self._reset, None
        events, self._events = tuple(self._events), []
        return TrackedFrame(
            frame,
            self._frames - 1,
            timestamp,
            "new" if self._frames == 1 else "warm",
            reset,
            tracked,
            events,
            job.timings_ms(),
        )

    def _time_of(self, timestamp: float | None, arrived: float) -> float:
        if timestamp is None:
            if self._frames == 0:
                return 0.0
            return self._timestamp + max(LEAST_STEP_S, arrived - self._arrived)
        if not timestamp >= self._timestamp + LEAST_STEP_S:
            raise LateFrameError(
                f"expected a timestamp after {self._timestamp:g} s, that of the camera's last "
                f"frame, got {timestamp:g} s"
            )
        return timestamp

    def _begin_anew_where_needed(self, shape: tuple[int, ...], timestamp: float) -> None:
        """Drop all tracks where the frame cannot continue those before."""
        before, self._size = self._size, shape[:2]
        gap = timestamp - self._timestamp
        if before is None:
            return
        if before != self._size:
            (height, width), (rows, columns) = before, self._size
            reason = f"frames were {width}x{height} pixels before, this one is {columns}x{rows}"
        elif self._frames and gap > LONGEST_GAP_S:
            reason = f"no frame came for {gap:.1f} s, more than {LONGEST_GAP_S:g} s"
        else:
            return
        self._reset = reason
        self._follower = TrackedPeopleDetector(self._estimator.finder)
        for track in self._tracks:
            self._tell("left", track, timestamp)
        self._tracks = []

    def _named(
        self,
        people: Sequence[ObservedPerson],
        caller_ids: Sequence[str] | None,
        timestamp: float,
    ) -> list[tuple[ObservedPerson, Track | None]]:
        """People whose identities the caller may have given, with their tracks if so."""
        if caller_ids is None:
            return [(person, None) for person in people]
        known = {track.caller_id: track for track in self._tracks}
        found = []
        for person, caller_id in zip(people, caller_ids, strict=True):
            track = known.get(caller_id) or self._begin(Sighting(person, None), timestamp)
            if track is not None:
                track.caller_id = caller_id
            found.append((person, track))
        return found

    def _identify(
        self,
        frame: NDArray[np.uint8] | None,
        found: list[tuple[ObservedPerson, Track | None]],
        timestamp: float,
    ) -> list[tuple[ObservedPerson, Track]]:
        """Give each person a track, and return those of confirmed tracks, left to right.

        Those who are hidden behind somebody are among them, where they are expected.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array or None
            None if the caller sent a mask alone: what they wear is not seen then.
        found : list of (ObservedPerson, Track or None)
            With the track in whose window each was read.
        timestamp : float
        """
        sightings = [_sighting(frame, *pair) for pair in found]
        # Whom the caller names is the caller's.
        known = [track if track and track.caller_id else None for _, track in found]
        free = [i for i, track in enumerate(known) if track is None]
        others = [track for track in self._tracks if track not in known]
        for i, row in zip(
            free, associate(others, [sightings[i] for i in free], timestamp), strict=True
        ):
            known[i] = None if row is None else others[row]
        seen = []
        for (person, _), track, sighting in zip(found, known, sightings, strict=True):
            own = track or self._begin(sighting, timestamp)
            if own is not None:
                own.see(sighting, timestamp, self.zones)
                seen.append((person, own))
        seen += [
            (ObservedPerson(box, "track", None, None), track)
            for track in self._tracks
            if track.seen_at < timestamp and (box := self._hidden(track, timestamp)) is not None
        ]
        for track in self._tracks:
            track.age_frames += 1
            if track.track_id is None and track.is_confirmed:
                self._given_ids += 1
                track.track_id = self._given_ids
                self._tell("entered", track, timestamp)
        confirmed = [(person, track) for person, track in seen if track.track_id is not None]
        return sorted(confirmed, key=lambda pair: pair[0].box.x)

    def _begin(self, sighting: Sighting, timestamp: float) -> Track | None:
        """A track of a newcomer, None where there are too many."""
        if len(self._tracks) >= 2 * self._estimator.finder.max_persons:
            return None
        track = Track(sighting, timestamp)
        self._tracks.append(track)
        return track

    def _forget_unseen(self, timestamp: float) -> None:
        kept = []
        for track in self._tracks:
            predicted = track.track_id is not None and (
                self._hidden(track, timestamp) is not None or self._vanished(track)
            )
            longest = PREDICTED_FOR_S if predicted else FORGOTTEN_AFTER_S
            if timestamp - track.seen_at <= longest:
                kept.append(track)
            else:
                self._tell("left", track, timestamp)
        self._tracks = kept

    def _hidden(self, track: Track, timestamp: float) -> Box | None:
        """Where somebody is expected who is hidden behind another one; None if nobody hides them.

        Who has been hidden for longer than :data:`PREDICTED_FOR_S` is not predicted any more.
        """
        if self._size is None or timestamp - track.seen_at > PREDICTED_FOR_S:
            return None
        box = track.motion.predict(timestamp).clip(self._size[1], self._size[0])
        hides = [
            other.motion.predict(timestamp)
            for other in self._tracks
            if other is not track and other.seen_at == timestamp
        ]
        if box and any(other.intersection(box) >= HIDDEN_FROM * box.area for other in hides):
            return box
        return None

    def _vanished(self, track: Track) -> bool:
        """Whether somebody is no longer seen whom the detector saw last, away from the border."""
        return (
            self._size is not None
            and track.next_window is not None
            and not ends_at_border(track.motion.seen, self._size)
        )

    def _with_poses(
        self,
        seen: list[tuple[ObservedPerson, Track]],
        frame: NDArray[np.uint8],
        timestamp: float,
        n: int,
        job: Job,
    ) -> tuple[TrackedPerson, ...]:
        searched = [i for i, (person, _) in enumerate(seen) if person.silhouette is not None]
        scene = Scene(frame, tuple(seen[i][0] for i in searched))
        persons = self._estimator.with_hypotheses(scene, max(n, DEFAULT_HYPOTHESES), job)
        found = dict(zip(searched, persons, strict=True))
        tracked = []
        for i, (observed, track) in enumerate(seen):
            result = (
                track.update(found[i], timestamp, self.zones)
                if i in found
                else track.extrapolate(observed, timestamp)
            )
            self._events += track.take_events()
            shown = replace(result.person, hypotheses=result.person.hypotheses[:n])
            tracked.append(replace(result, person=shown))
        return tuple(tracked)

    def _tell(self, event: Literal["entered", "left"], track: Track, timestamp: float) -> None:
        if track.track_id is not None:
            moment = Event(event, track.track_id, "instant", timestamp, track.score)
            self._events.append(track.told(moment))


def _sighting(
    frame: NDArray[np.uint8] | None, person: ObservedPerson, followed: Track | None
) -> Sighting:
    if frame is None or person.silhouette is None:
        return Sighting(person, None, followed)
    return Sighting(person, appearance_histogram(frame, person.silhouette), followed)
