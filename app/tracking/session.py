"""A camera session: frames of one fixed camera, in order, to people with identities."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.estimates import Evidence, ObservedPerson, Scene
from app.estimator import Estimator
from app.finder import Check
from app.reranking import keep_nearest
from app.stopwatch import Stopwatch
from app.tracking.association import associate
from app.tracking.results import Event, TrackedFrame, TrackedPerson
from app.tracking.search import PeopleSearch
from app.tracking.smoothing import STATES
from app.tracking.track import Sighting, Track, clothes_histogram
from app.tracking.zones import Zone
from app.upload import Upload

CANDIDATES_PER_HYPOTHESIS = 7
"""Fewer than a single frame's: a person takes half the time."""

LONGEST_GAP_S = 10.0
"""After a longer gap the session begins anew: the scene may be another."""

FORGOTTEN_AFTER_S, LEAVING_FOR_S, TENTATIVE_FOR_S = 2.0, 0.5, 0.5
"""How long a track lives unseen: inside the frame, at its edge, and before it is confirmed."""

FOUND_WITHIN_S = 8.0
"""A track that neither detector nor keypoints show to be a person for this long is dropped: what
moves may be a car, or a curtain."""

READ_PER_FRAME, READ_EVERY_S = 1, 0.25
"""People whose keypoints are read at a time, those whose last ones are oldest, and how often."""

POSES_PER_FRAME, LEAST_SHARE_OF_POSES = 2, 0.25
"""People whose poses are searched for on a live frame, or this share of all if that is more: those
whose last ones are oldest. The others keep theirs, at the place where they are now."""

# People expected this near to the frame's edge leave it.
_EDGE_PX = 3.0


class LateFrameError(ValueError):
    """A frame is not later than the one before."""


class CameraSession:
    """Frames of one fixed camera; takes one at a time.

    Memory is bounded: by the background model, which has the frame's size, and by the number of
    tracks, twice that of the people in a frame.

    Parameters
    ----------
    estimator : Estimator
    clock : callable
        Seconds, for frames without a timestamp.
    live : bool
        Whether frames have to be kept up with: poses are then searched for a few people a frame,
        see :data:`POSES_PER_FRAME`, else for all.
    """

    def __init__(
        self,
        estimator: Estimator,
        clock: Callable[[], float] = time.monotonic,
        *,
        live: bool = True,
    ) -> None:
        self._estimator = estimator
        self._clock = clock
        self._live = live
        self.zones: Sequence[Zone] = ()
        """Those of the camera; may be changed between frames."""
        self._search = PeopleSearch(estimator.finder, estimator.map_parts)
        self._tracks: list[Track] = []
        self._given_ids = 0
        self._frames = 0
        self._size: tuple[int, ...] | None = None
        self._timestamp = -math.inf
        self._arrived = 0.0
        self._read_at = -math.inf
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
        """About what the session holds, mostly the background model."""
        return self._search.memory_bytes + 2000 * len(self._tracks)

    def process(
        self,
        upload: Upload,
        timestamp: float | None,
        n: int,
        check: Check,
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
        check : callable
            Called between steps; raises where the work is no longer wanted. The next frame then
            tells what began or ended at this one.
        evidence : str
            As in :meth:`app.estimator.Estimator.estimate`.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        LateFrameError
            If the timestamp is not after that of the frame before.
        """
        arrived = self._clock()
        timestamp = self._time_of(timestamp, arrived)
        stopwatch = Stopwatch()
        check()
        with stopwatch.stage("decode"):
            decoded = self._estimator.decode(upload)
        check()
        frame = decoded.frame
        self._begin_anew_where_needed(frame.shape, timestamp)
        self._timestamp, self._arrived = timestamp, arrived
        self._frames += 1
        reads = evidence == "photograph" and upload.frame is not None
        found: list[tuple[ObservedPerson, Track | None]]
        if upload.mask is None and upload.boxes is None and upload.background is None:
            found = self._search.find(frame, timestamp, self._tracks, check, stopwatch)
        else:
            people = self._estimator.finder.find(decoded, reads, check, stopwatch)
            found = self._named(people, upload.track_ids, timestamp)
        seen = self._identify(frame if upload.frame is not None else None, found, timestamp)
        self._forget_unseen(timestamp)
        if reads and timestamp - self._read_at >= READ_EVERY_S:
            seen = self._with_keypoints(seen, frame, timestamp, check, stopwatch)
        tracked = self._with_poses(seen, frame, timestamp, n, check, stopwatch)
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
            {**stopwatch.milliseconds, "total": stopwatch.total()},
        )

    def _time_of(self, timestamp: float | None, arrived: float) -> float:
        if timestamp is None:
            if self._frames == 0:
                return 0.0
            return self._timestamp + max(1e-3, arrived - self._arrived)
        if not timestamp > self._timestamp:
            raise LateFrameError(
                f"expected a timestamp after {self._timestamp:g} s, that of the camera's last "
                f"frame, got {timestamp:g} s"
            )
        return timestamp

    def _begin_anew_where_needed(self, shape: tuple[int, ...], timestamp: float) -> None:
        """Forget tracks and background where the frame cannot continue those before."""
        before, self._size = self._size, shape[:2]
        gap = timestamp - self._timestamp
        if before is None:
            return
        if before != self._size:
            (height, width), (rows, columns) = before, self._size
            reason = f"frames were {width}x{height} pixels before, this one is {columns}x{rows}"
        elif gap > LONGEST_GAP_S:
            reason = f"no frame came for {gap:.1f} s, more than {LONGEST_GAP_S:g} s"
        else:
            return
        self._reset = reason
        self._search = PeopleSearch(self._estimator.finder, self._estimator.map_parts)
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

        Parameters
        ----------
        frame : (H, W, 3) uint8 array or None
            None if the caller sent a mask alone: clothes are not seen then.
        found : list of (ObservedPerson, Track or None)
        timestamp : float
        """
        sightings = [_sighting(frame, person) for person, _ in found]
        free = [i for i, (_, track) in enumerate(found) if track is None]
        assigned = associate(self._tracks, [sightings[i] for i in free], timestamp)
        tracks = [track for _, track in found]
        for i, row in zip(free, assigned, strict=True):
            tracks[i] = None if row is None else self._tracks[row]
        taken = {tracks[i] for i in free}
        seen = []
        for (person, expected), track, sighting in zip(found, tracks, sightings, strict=True):
            if expected is not None and expected in taken:
                continue  # Somebody was found who is the one expected here.
            own = track or self._begin(sighting, timestamp)
            if own is not None:
                own.see(sighting, timestamp, self.zones)
                seen.append((person, own))
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
            if track.track_id is None:
                longest = TENTATIVE_FOR_S
            else:
                longest = LEAVING_FOR_S if self._leaves(track, timestamp) else FORGOTTEN_AFTER_S
            unseen, unfound = timestamp - track.seen_at, timestamp - track.found_at
            if unseen <= longest and unfound <= FOUND_WITHIN_S:
                kept.append(track)
            else:
                self._tell("left", track, timestamp)
        self._tracks = kept

    def _leaves(self, track: Track, timestamp: float) -> bool:
        """Whether somebody is expected at the frame's edge."""
        if self._size is None:
            return False
        height, width = self._size
        box = track.motion.expect(timestamp)
        return (
            min(box.x, box.y) < _EDGE_PX
            or box.right > width - _EDGE_PX
            or box.bottom > height - _EDGE_PX
        )

    def _with_keypoints(
        self,
        seen: list[tuple[ObservedPerson, Track]],
        frame: NDArray[np.uint8],
        timestamp: float,
        check: Check,
        stopwatch: Stopwatch,
    ) -> list[tuple[ObservedPerson, Track]]:
        """Read the keypoints of those whose last ones are oldest."""
        cut_out = [i for i, (person, _) in enumerate(seen) if person.silhouette is not None]
        oldest = sorted(cut_out, key=lambda i: seen[i][1].read_at)[:READ_PER_FRAME]
        result = list(seen)
        with stopwatch.stage("keypoints"):
            for i in oldest:
                check()
                person, track = seen[i]
                person = self._estimator.finder.with_keypoints(frame, person)
                track.read_at = self._read_at = timestamp
                if person.keypoints is not None:
                    track.found_at = timestamp
                result[i] = person, track
        return result

    def _with_poses(
        self,
        seen: list[tuple[ObservedPerson, Track]],
        frame: NDArray[np.uint8],
        timestamp: float,
        n: int,
        check: Check,
        stopwatch: Stopwatch,
    ) -> tuple[TrackedPerson, ...]:
        """Search for the poses of those whose last ones are oldest; the others keep theirs."""
        searched = [i for i, (person, _) in enumerate(seen) if person.silhouette is not None]
        if self._live:
            most = max(POSES_PER_FRAME, math.ceil(LEAST_SHARE_OF_POSES * len(seen)))
            # Keypoints that have just been read come first.
            searched.sort(key=lambda i: (seen[i][0].keypoints is None, seen[i][1].posed_at))
            searched = sorted(searched[:most])
        scene = Scene(frame, tuple(seen[i][0] for i in searched))
        persons = self._estimator.with_hypotheses(
            scene, max(n, STATES), check, stopwatch, CANDIDATES_PER_HYPOTHESIS
        )
        found = dict(zip(searched, persons, strict=True))
        tracked = []
        for i, (observed, track) in enumerate(seen):
            result = (
                track.update(found[i], timestamp, self.zones)
                if i in found
                else track.carry(observed, timestamp)
            )
            self._events += track.take_events()
            shown = replace(result.person, hypotheses=keep_nearest(result.person.hypotheses, n))
            tracked.append(replace(result, person=shown))
        return tuple(tracked)

    def _tell(self, event: Literal["entered", "left"], track: Track, timestamp: float) -> None:
        if track.track_id is not None:
            moment = Event(event, track.track_id, "instant", timestamp, track.score)
            self._events.append(track.told(moment))


def _sighting(frame: NDArray[np.uint8] | None, person: ObservedPerson) -> Sighting:
    if frame is None or person.silhouette is None:
        return Sighting(person, None)
    return Sighting(person, clothes_histogram(frame, person.silhouette))
