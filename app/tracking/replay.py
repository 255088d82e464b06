"""Replays of events: the outlines of a person before and after, and no pixel of a frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person
from app.vision.geometry import Box
from app.vision.people import COCO_LANDMARKS, Silhouette
from index.skeleton import KEYPOINT_SETS

BEFORE_S, AFTER_S = 3.0, 3.0
_KEPT_S = 10.0  # A person lost for a while still has the seconds before.
_UNKNOWN = np.iinfo(np.int16).min
_MIN_VISIBILITY = 0.5
COCO = KEYPOINT_SETS["coco17"]


@dataclass(frozen=True, slots=True)
class Moment:
    """A person at one frame, in whole pixels of it, in 172 bytes at most, 280 with its objects.

    The points, int16, are the corners of the box, the COCO keypoints and the outline.
    """

    timestamp: float
    packed: bytes

    @classmethod
    def of(cls, person: Person, timestamp: float) -> Moment:
        """What is kept of a person at a frame."""
        box = person.box
        corners = np.array([[box.x, box.y], [box.right, box.bottom]])
        points = np.vstack([corners, _joints(person), _outline(person.silhouette)])
        known = np.rint(points).clip(_UNKNOWN + 1, -_UNKNOWN - 1)
        return cls(timestamp, np.nan_to_num(known, nan=_UNKNOWN).astype(np.int16).tobytes())

    @property
    def _points(self) -> NDArray[np.float64]:
        points = np.frombuffer(self.packed, np.int16).reshape(-1, 2).astype(np.float64)
        return np.where(points == _UNKNOWN, np.nan, points)

    @property
    def box(self) -> Box:
        """The person's box."""
        return Box.from_edges(*self._points[:2].ravel().tolist())

    @property
    def joints(self) -> NDArray[np.float64]:
        """The COCO keypoints ``(17, 2)``, NaN where they are not seen."""
        return self._points[2 : 2 + len(COCO.names)]

    @property
    def outline(self) -> NDArray[np.float64]:
        """The corners ``(P, 2)`` of the silhouette, none if it is not known."""
        return self._points[2 + len(COCO.names) :]


@dataclass(eq=False)
class Replay:
    """A person from before an event until after it; it grows until it is complete.

    ``shape`` is that of the frames; no moment is later than ``until``, in seconds.
    """

    track_id: int
    shape: tuple[int, ...]
    until: float
    moments: list[Moment]
    is_complete: bool = False


class Recorder:
    """The last seconds of each person of a session, and the replays that still grow."""

    def __init__(self) -> None:
        self._kept: dict[int, list[Moment]] = {}
        self._growing: list[Replay] = []
        self._last = -math.inf

    def add(self, timestamp: float, people: Mapping[int, Person]) -> None:
        """Add the people of a frame by their identities.

        If the clock was set back, nothing from before is kept.
        """
        is_later = timestamp >= self._last
        # Five moments a second show a fall; a hundred replays then take 0.9 MB.
        if is_later and timestamp < self._last + 0.19:
            return
        self._last = timestamp
        now = {one: Moment.of(person, timestamp) for one, person in people.items()}
        for replay in self._growing:
            replay.is_complete = not is_later or timestamp > replay.until
            if not replay.is_complete and replay.track_id in now:
                replay.moments.append(now[replay.track_id])
        self._growing = [one for one in self._growing if not one.is_complete]
        kept = self._kept if is_later else {}
        self._kept = {}
        for one in kept.keys() | now.keys():
            moments = [m for m in kept.get(one, ()) if m.timestamp >= timestamp - _KEPT_S]
            if one in now:
                moments.append(now[one])
            if moments:
                self._kept[one] = moments

    def begin(self, track_id: int, timestamp: float, shape: tuple[int, ...]) -> Replay:
        """Begin the replay of an event of the newest frame.

        It starts before the event or, if that was earlier, before the last sighting.
        """
        moments = self._kept.get(track_id, [])
        seen_at = moments[-1].timestamp if moments else timestamp
        kept = [one for one in moments if one.timestamp >= seen_at - BEFORE_S]
        replay = Replay(track_id, shape, timestamp + AFTER_S, kept)
        self._growing.append(replay)
        return replay


def _joints(person: Person) -> NDArray[np.float64]:
    """The keypoints ``(17, 2)`` that the photograph shows, else those of the first hypothesis."""
    landmarks = person.landmarks
    if landmarks is not None:
        unseen = landmarks.visibility < _MIN_VISIBILITY
        return np.where(unseen[:, None], np.nan, landmarks.positions)[COCO_LANDMARKS]
    if person.hypotheses:
        return person.hypotheses[0].points_2d[list(COCO.indices)]
    return np.full((len(COCO.names), 2), np.nan)


def _outline(silhouette: Silhouette | None) -> NDArray[np.float64]:
    """The corners ``(P, 2)`` of the largest part of a silhouette."""
    if silhouette is None:
        return np.empty((0, 2))
    largest = max(silhouette.outlines(cv2.CHAIN_APPROX_SIMPLE), key=cv2.contourArea)
    corners, within_px = largest[:, 0], 1.0
    while len(corners) > 24:
        corners = cv2.approxPolyDP(largest, within_px, True)[:, 0].astype(np.int32)
        within_px *= 1.25
    return corners.astype(np.float64)
