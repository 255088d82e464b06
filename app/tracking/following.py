"""Finds the people of a camera's frame: tracked people in their windows, new people by a search.

Landmarks of tracked people are read on every frame, in the windows that their last landmarks point
to. Now and then, and if a track's window no longer shows anybody, the whole frame is searched, to
find new people and to check the tracks: MoveNet, which needs no window, finds people whose windows
have drifted off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from app.estimation.finder import PeopleFinder, Target
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.tracking.track import Sighting, Track
from app.vision.blazepose import PoseReading
from app.vision.geometry import PersonWindow
from app.vision.silhouettes import ends_at_border

SEARCH_EVERY_S = 0.4
"""Time between two searches of the whole frame."""

# A track's window is read for this long after a sighting.
_WINDOW_LASTS_S = 0.5
# Overlap of a detection with the predicted box of its track.
_MIN_TRACK_IOU = 0.3

Expected = Mapping[Track, PersonWindow | PoseReading]
"""Windows in which tracks expect their people, or the readings in them."""


class TrackedPeopleDetector:
    """Finds people frame by frame; one frame at a time.

    Parameters
    ----------
    finder : PeopleFinder
        Searches, reads and observes.
    """

    def __init__(self, finder: PeopleFinder) -> None:
        self._finder = finder
        self._searched_at = self._read_at = -math.inf

    def find(
        self, upload: DecodedUpload, timestamp: float, tracks: Sequence[Track], job: Job
    ) -> list[Sighting]:
        """Find the people of a frame with their silhouettes and landmarks.

        Parameters
        ----------
        upload : DecodedUpload
            Of the frame.
        timestamp : float
            Seconds.
        tracks : sequence of Track
            All tracks of the session.
        job : Job
            Charged with the time of each stage.

        Returns
        -------
        list of Sighting
            Each has the track in whose window the person was read, or None after a search.
        """
        targets = self._targets(upload.frame, timestamp, tracks, job)
        people = self._finder.observe(upload, [target for target, _ in targets], job, tight=True)
        self._read_at = timestamp
        return [
            Sighting(person, track=track)
            for person, (_, track) in zip(people, targets, strict=True)
            if person is not None
        ]

    def _targets(
        self, frame: NDArray[np.uint8], timestamp: float, tracks: Sequence[Track], job: Job
    ) -> list[tuple[Target, Track | None]]:
        """Tracks in their windows or, if that is not enough, all people found by a search.

        The search uses a lower threshold near people who have been lost, until their tracks end. A
        lost track that was not confirmed, or whose person has left the frame, does not cause a
        search before the next one is due.
        """
        recent = [track for track in tracks if timestamp - track.seen_at <= _WINDOW_LASTS_S]
        expected: Expected = {one: one.next_window for one in recent if one.next_window}
        people = [track for track in tracks if track.track_id is not None]
        lost = [track for track in people if track.seen_at < self._read_at]
        due = timestamp - self._searched_at >= SEARCH_EVERY_S
        if expected and len(expected) == len(recent) and not due:
            expected = self._shown(frame, timestamp, expected, job)
            gone = [track for track in people if track in recent and track not in expected]
            if all(ends_at_border(track.box_filter.seen, frame.shape) for track in gone):
                return _followed(expected, timestamp)
            lost += [track for track in gone if track not in lost]
        found = self._finder.search(frame, job, [track.box_filter.seen for track in lost])
        self._searched_at = timestamp
        unseen = dict(expected)
        targets: list[tuple[Target, Track | None]] = []
        for one in found:
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
        readings = zip(expected, self._finder.read(frame, targets, job, masks=True), strict=True)
        return {track: reading for track, reading in readings if reading is not None}


def _followed(expected: Expected, timestamp: float) -> list[tuple[Target, Track | None]]:
    """Targets of tracks at their predicted boxes."""
    return [
        (Target(track.box_filter.predict(timestamp), track.score, None, window), track)
        for track, window in expected.items()
    ]
