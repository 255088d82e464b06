"""Finds the people of a camera's frame: tracked people in their windows, new people by a search.

Landmarks of tracked people are read on every frame, in the windows that their last landmarks point
to. Now and then, and if a track's window no longer shows anybody, the whole frame is searched, to
find new people and to check the tracks: MoveNet, which needs no window, finds people whose windows
have drifted off. While nothing changes around tracked people, searches are rarer.
"""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.finder import PeopleFinder, Target
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.tracking.track import Sighting, Track
from app.vision.blazepose import PoseReading
from app.vision.detector import smallest_person_px
from app.vision.geometry import Box, PersonWindow, shrink_quickly
from app.vision.silhouettes import ends_at_border

SEARCH_EVERY_S = 0.4
"""Time between two searches of the whole frame if it changes around the tracked people."""

STILL_SEARCH_EVERY_S = 3.0
"""The same while it does not."""

# A track's window is read for this long after a sighting.
_WINDOW_LASTS_S = 0.5
# Overlap of a detection with the predicted box of its track.
_MIN_TRACK_IOU = 0.3

Expected = Mapping[Track, PersonWindow | PoseReading]
"""Windows in which tracks expect their people, or the readings in them."""


class TrackedPeopleDetector:
    """Finds people frame by frame; one frame at a time."""

    def __init__(self, finder: PeopleFinder) -> None:
        self._finder = finder
        self._searched_at = self._read_at = -math.inf
        self._scene = _Scene()

    def find(
        self, upload: DecodedUpload, timestamp: float, tracks: Sequence[Track], job: Job
    ) -> list[Sighting]:
        """Find the people of a frame with their silhouettes and landmarks, given all tracks.

        Each sighting has the track whose window shows the person; None if none does.
        """
        targets = self._targets(upload.frame, timestamp, tracks, job)
        people = self._finder.observe(upload, [target for target, _ in targets], job, tight=True)
        self._read_at = timestamp
        sightings: dict[int, Sighting] = {}
        for person, (_, track) in zip(people, targets, strict=True):
            # A person who was detected stands again where a track's window shows them.
            if person is not None and (
                id(person) not in sightings or sightings[id(person)].track is None
            ):
                sightings[id(person)] = Sighting(person, track=track)
        return list(sightings.values())

    def _targets(
        self, frame: NDArray[np.uint8], timestamp: float, tracks: Sequence[Track], job: Job
    ) -> list[tuple[Target, Track | None]]:
        """Tracks in their windows or, if that is not enough, all people found by a search.

        The search uses a lower threshold near people who have been lost, until their tracks end. A
        lost track that was not confirmed, or whose person has left the frame or was hardly seen
        behind others, does not cause a search before the next one is due; nor does a person who
        fell and lies where they were last seen. Without tracks, every frame is searched unless the
        scene is still.
        """
        recent = [track for track in tracks if timestamp - track.seen_at <= _WINDOW_LASTS_S]
        expected: Expected = {one: one.next_window for one in recent if one.next_window}
        people = [track for track in tracks if track.track_id is not None]
        lost = [track for track in people if track.seen_at < self._read_at]
        smallest = smallest_person_px(frame.shape, self._finder.min_person_px)
        still = self._scene.is_still(frame, smallest, timestamp, tracks)
        still &= len(expected) == len(people) == len(tracks) and not lost
        interval = STILL_SEARCH_EVERY_S if still else SEARCH_EVERY_S
        due = timestamp - self._searched_at >= interval
        lies = any(track.lies_at for track in tracks)
        if (expected or still or lies) and len(expected) == len(recent) and not due:
            expected = self._shown(frame, timestamp, expected, job)
            gone = [track for track in people if track in recent and track not in expected]
            may_be_there = [
                track
                for track in gone
                if not (track.beside or ends_at_border(track.box_filter.seen, frame.shape))
            ]
            if not may_be_there:
                return _followed(expected, timestamp)
            lost += [track for track in gone if track not in lost]
        known = [one.box_filter.predict(timestamp) for one in expected if one in people]
        found = self._finder.search(frame, job, [one.box_filter.seen for one in lost], known)
        self._searched_at = timestamp
        self._scene.restart()
        unseen = dict(expected)
        targets: list[tuple[Target, Track | None]] = []
        for one in found:
            if not one.certain:
                targets.append((Target(one.box, one.score, one), None))
                continue
            overlap = {track: track.box_filter.predict(timestamp).iou(one.box) for track in unseen}
            track = max(overlap, key=lambda other: overlap[other], default=None)
            same = track is not None and overlap[track] >= _MIN_TRACK_IOU
            window = unseen.pop(track) if same and track else None
            targets.append((Target(one.box, one.score, one, window), None))
        return targets + _followed(unseen, timestamp)

    def _shown(
        self, frame: NDArray[np.uint8], timestamp: float, expected: Expected, job: Job
    ) -> Expected:
        """Read tracks in their windows; those that still show their people, with the readings."""
        targets = [target for target, _ in _followed(expected, timestamp)]
        readings = zip(expected, self._finder.read(frame, targets, job), strict=True)
        return {track: reading for track, reading in readings if reading is not None}


def _followed(expected: Expected, timestamp: float) -> list[tuple[Target, Track | None]]:
    """Targets of tracks at their predicted boxes."""
    return [
        (Target(track.box_filter.predict(timestamp), track.score, None, window), track)
        for track, window in expected.items()
    ]


# Height of the smallest wanted person where frames are compared, and their longest side. Cells are
# means of many pixels, so a sensor's noise of 4 levels becomes less than one.
_PERSON_CELLS, _MAX_CELLS = 8, 640
# A change is a connected area, wider than it was by a cell on every side, that is this high: more
# than half of the smallest person, and more than the digits of a camera's clock.
_MIN_CHANGE_CELLS = 7
# Difference of means over 3x3 cells, grey levels.
_MIN_DIFFERENCE = 5
# A scene is still after this time: a person may be missed in the frame in which they move.
_STILL_AFTER_S = 2.0
# Margin around tracked people, as a share of the larger side of their boxes.
_TRACK_MARGIN = 0.1


class _Scene:
    """What a fixed camera shows around tracked people, compared with the last search's frame.

    Changes since then add up, so also slow ones are noticed.
    """

    def __init__(self) -> None:
        self._now: NDArray[np.uint8] | None = None
        self._searched: NDArray[np.uint8] | None = None
        self._boxes: dict[Track, Box] = {}  # Where tracked people were at the last search.
        self._changed_at = -math.inf

    def is_still(
        self, frame: NDArray[np.uint8], smallest_px: float, time: float, tracks: Sequence[Track]
    ) -> bool:
        """Whether nothing has changed for a while; the first frame counts as a change.

        The smallest person wanted is ``smallest_px`` high in the frame.
        """
        scale = min(1.0, _PERSON_CELLS / smallest_px, _MAX_CELLS / max(frame.shape))
        height, width = (max(1, round(side * scale)) for side in frame.shape[:2])
        small = shrink_quickly(frame, width, height)
        self._now = now = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)
        places = [track.box_filter.predict(time) for track in tracks]
        # Tracks that have ended are let go.
        self._boxes = {one: self._boxes.get(one, one.box_filter.seen) for one in tracks}
        places += self._boxes.values()
        if self._searched is None or self._differs(self._searched, now, scale, places):
            self._changed_at = time
        return time - self._changed_at >= _STILL_AFTER_S

    def restart(self) -> None:
        """Compare with the present frame from now on, since it is searched."""
        self._searched, self._boxes = self._now, {}

    @staticmethod
    def _differs(
        before: NDArray[np.uint8], now: NDArray[np.uint8], scale: float, places: Sequence[Box]
    ) -> bool:
        """Whether two small grey pictures ``(h, w)`` differ outside these boxes of the frame."""
        differences = cv2.subtract(now, before, dtype=cv2.CV_16S)
        sums = cv2.boxFilter(differences, cv2.CV_32S, (3, 3), normalize=False)
        changed = (np.abs(sums) >= 9 * _MIN_DIFFERENCE).astype(np.uint8)
        for box in (place.scaled(scale) for place in places):
            left, top, right, bottom = box.pixels()
            margin = 1 + round(_TRACK_MARGIN * max(box.width, box.height))
            rows = slice(max(0, top - margin), max(0, bottom + margin))
            changed[rows, max(0, left - margin) : max(0, right + margin)] = 0
        _, _, areas, _ = cv2.connectedComponentsWithStats(changed)
        return bool((areas[1:, cv2.CC_STAT_HEIGHT] >= _MIN_CHANGE_CELLS).any())
