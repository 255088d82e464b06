"""Finds the people of a fixed camera's frames: in what moves, and where tracks expect them.

The detector is shown the whole frame while the background is not known, and every two seconds, so
that people who stand still stay known. In between it is shown a part of the frame at most: where
tracks touch or are not clearly seen, or where something moves that no track explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.estimates import ObservedPerson
from app.executor import Map, map_serially
from app.finder import Check, PeopleFinder, segment_turned
from app.stopwatch import Stopwatch
from app.tracking.moving import BackgroundModel, MovingRegions
from app.tracking.track import Track
from app.vision.boxes import intersections
from app.vision.detection.detector import SAME_PERSON
from app.vision.people import Box, Detection, Silhouette
from app.vision.resampling import Window, cut
from app.vision.segmentation.truncation import with_truncation

SEARCH_EVERY_S = 2.0
"""Time between two searches of the whole frame."""

NETWORK_CUTS = 1
"""People whom tracks expect and the network cuts out, on a frame not searched as a whole."""

# Room about people in a part of the frame that is searched, as a share of their height.
_ROOM = 0.25
# People who end this near to the edge of such a part are cut by it.
_CUT_PX = 3.0
# Regions lower than this share of the smallest person wanted are not searched.
_LEAST_HEIGHT = 0.8
# Somebody slower than this, in heights a second, with less than this share of the box moving,
# stands where they stood.
_STILL_SPEED, _STILL_SHARE = 0.3, 0.1
# How much of somebody has to be inside the frame.
_MOSTLY = 0.7
# How long somebody is believed to move on as expected while others hide who is who.
_BELIEVED_S = 1.0
# How long a place where something moves and nobody was found is left alone.
_LEFT_ALONE_S = 1.0


class PeopleSearch:
    """Finds people frame by frame; one frame at a time.

    Parameters
    ----------
    finder : PeopleFinder
        Its detector and segmenter are used.
    map_parts : callable
        Works on the parts of a frame; see :class:`app.executor.Map`.
    """

    def __init__(self, finder: PeopleFinder, map_parts: Map = map_serially) -> None:
        self._finder = finder
        self._background = BackgroundModel(map_parts)
        self._searched_at = -math.inf
        self._last = -math.inf
        self._newcomers_at = -math.inf
        self.detected_at = -math.inf
        """When the detector last looked, at the whole frame or a part of it."""
        # Where nobody was found of late, with the time of the search.
        self._empty: list[tuple[Box, float]] = []

    @property
    def memory_bytes(self) -> int:
        """Size of the background model."""
        return self._background.memory_bytes

    def find(
        self,
        frame: NDArray[np.uint8],
        timestamp: float,
        tracks: Sequence[Track],
        check: Check,
        stopwatch: Stopwatch,
    ) -> list[tuple[ObservedPerson, Track | None]]:
        """Find the people of a frame with their silhouettes.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        timestamp : float
            Seconds.
        tracks : sequence of Track
        check : callable
        stopwatch : Stopwatch

        Returns
        -------
        list of (ObservedPerson, Track or None)
            The track where nothing but its expectation says who is there, else None.
        """
        with stopwatch.stage("detect"):
            moving = self._background.update(frame, timestamp)
        check()
        if moving is None or timestamp - self._searched_at >= SEARCH_EVERY_S:
            found = self._everywhere(frame, moving, check, stopwatch)
            self._searched_at = self.detected_at = timestamp
            for track in tracks:
                track.searched_at = timestamp
        else:
            found = self._about(tracks, frame, timestamp, moving, check, stopwatch)
        self._last = timestamp
        return found

    def _everywhere(
        self,
        frame: NDArray[np.uint8],
        moving: MovingRegions | None,
        check: Check,
        stopwatch: Stopwatch,
    ) -> list[tuple[ObservedPerson, Track | None]]:
        with stopwatch.stage("detect"):
            detections = self._finder.detector.detect(frame)[: self._finder.max_persons]
        check()
        with stopwatch.stage("segment"):
            boxes = [detection.box for detection in detections]
            clear = moving.silhouettes(boxes) if moving else [None] * len(boxes)
            silhouettes = self._cut_out(frame, detections, clear)
        return [
            (person, None)
            for person in _detected(detections, silhouettes)
            # A detection without a silhouette was hardly a person.
            if person.silhouette is not None
        ]

    def _about(
        self,
        tracks: Sequence[Track],
        frame: NDArray[np.uint8],
        timestamp: float,
        moving: MovingRegions,
        check: Check,
        stopwatch: Stopwatch,
    ) -> list[tuple[ObservedPerson, Track | None]]:
        rows, columns = frame.shape[:2]
        inside = [
            (track, box)
            for track in tracks
            if (box := track.motion.expect(timestamp).clip(columns, rows)) is not None
        ]
        with stopwatch.stage("segment"):
            silhouettes = moving.silhouettes([box for _, box in inside])
        clear = [silhouette for silhouette in silhouettes if silhouette is not None]
        unclear = [
            (track, box)
            for (track, box), silhouette in zip(inside, silhouettes, strict=True)
            if silhouette is None
        ]
        with stopwatch.stage("detect"):
            # Every other frame at most: between, keypoints are read.
            rests = self.detected_at == self._last
            part = None if rests else self._next_part(unclear, inside, moving, timestamp)
            self.detected_at = self.detected_at if part is None else timestamp
            detections = [] if part is None else self._detect_in(frame, part, clear)
        check()
        # Those of whom the detector found no better place.
        expected = [
            (track, box)
            for track, box in unclear
            if all(box.iou(detection.box) < SAME_PERSON for detection in detections)
            and self._is_believed(track, box, moving, timestamp)
        ]
        expected.sort(key=lambda pair: pair[0].cut_at)
        looked_at = [
            *detections,
            *(Detection(box, 0.0) for _, box in expected[: max(0, NETWORK_CUTS - len(detections))]),
        ]
        with stopwatch.stage("segment"):
            found: list[Silhouette | None] = []
            if detections:
                boxes = [*(d.box for d in detections), *(s.box for s in clear)]
                found = moving.silhouettes(boxes)[: len(detections)]
            cuts = self._cut_out(
                frame, looked_at, [*found, *[None] * (len(looked_at) - len(detections))]
            )
        flagged = with_truncation(
            [*clear, *cuts],
            [*(silhouette.box for silhouette in clear), *(d.box for d in looked_at)],
            frame.shape,
        )
        people: list[tuple[ObservedPerson, Track | None]] = [
            (ObservedPerson(silhouette.box, "background", None, silhouette), None)
            for silhouette in flagged[: len(clear)]
            if silhouette is not None
        ]
        cuts = flagged[len(clear) :]
        people += [
            (person, None)
            for person in _detected(detections, cuts)
            if person.silhouette is not None
        ]
        by_network = cuts[len(detections) :]
        for place, (track, box) in enumerate(expected):
            silhouette = by_network[place] if place < len(by_network) else None
            people.append((ObservedPerson(box, "track", None, silhouette), track))
        return people

    def _is_believed(self, track: Track, box: Box, moving: MovingRegions, timestamp: float) -> bool:
        """Whether somebody is where they are expected although nothing shows them clearly."""
        # Somebody who has all but left the frame has left it.
        if not track.is_confirmed or box.area < _MOSTLY * track.motion.expect(timestamp).area:
            return False
        if _is_still(track, box, moving):
            # The last search of the whole frame found them, or they came to rest after it.
            return track.motion.timestamp >= self._searched_at
        recent = timestamp - track.motion.timestamp <= _BELIEVED_S
        return recent and moving.moving_share(box) >= _STILL_SHARE

    def _next_part(
        self,
        unclear: Sequence[tuple[Track, Box]],
        inside: Sequence[tuple[Track, Box]],
        moving: MovingRegions,
        timestamp: float,
    ) -> Box | None:
        """The part of the frame that has waited longest for the detector."""
        least_height = _LEAST_HEIGHT * self._finder.min_person_px
        self._empty = [
            (box, since) for box, since in self._empty if timestamp - since < _LEFT_ALONE_S
        ]
        newcomers = [
            box
            for box in moving.unexplained([box for _, box in inside], least_height)
            if all(box.iou(other) < SAME_PERSON for other, _ in self._empty)
        ]
        groups = _touching([box for _, box in unclear])
        waiting = [
            (min(unclear[i][0].searched_at for i in group), [unclear[i][1] for i in group])
            for group in groups
            if any(not _is_still(unclear[i][0], unclear[i][1], moving) for i in group)
        ]
        if newcomers:
            waiting.append((self._newcomers_at, newcomers[:1]))
        if not waiting:
            return None
        since, boxes = min(waiting, key=lambda part: part[0])
        if newcomers and since == self._newcomers_at:
            self._newcomers_at = timestamp
            self._empty.append((boxes[0], timestamp))
        for track, box in unclear:
            if box in boxes:
                track.searched_at = timestamp
        return _around(boxes)

    def _detect_in(
        self, frame: NDArray[np.uint8], part: Box, clear: Sequence[Silhouette]
    ) -> list[Detection]:
        """Search a part of a frame for people other than those who are clear."""
        inside = part.clip(frame.shape[1], frame.shape[0])
        if inside is None:
            return []
        left, top, right, bottom = inside.pixels()
        window: Window = left, top, right - left, bottom - top
        found = [
            replace(d, box=Box(d.box.x + left, d.box.y + top, d.box.width, d.box.height))
            for d in self._finder.detector.detect(np.ascontiguousarray(cut(frame, window)))
        ]
        return [
            d
            for d in found
            if not _is_cut(d.box, inside, frame.shape)
            and all(d.box.iou(s.box) < SAME_PERSON for s in clear)
        ]

    def _cut_out(
        self,
        frame: NDArray[np.uint8],
        detections: Sequence[Detection],
        clear: Sequence[Silhouette | None],
    ) -> list[Silhouette | None]:
        """Silhouettes of the background where they are clear, else those of the network."""
        found = list(clear)
        rest = [i for i, silhouette in enumerate(found) if silhouette is None]
        silhouettes = segment_turned(
            self._finder.segmenter,
            frame,
            [detections[i].box for i in rest],
            [detections[i].quarter_turns for i in rest],
        )
        for i, silhouette in zip(rest, silhouettes, strict=True):
            found[i] = silhouette
        return with_truncation(found, [detection.box for detection in detections], frame.shape)


def _detected(
    detections: Sequence[Detection], silhouettes: Sequence[Silhouette | None]
) -> list[ObservedPerson]:
    return [
        ObservedPerson(
            found.box, "detector", found.score, silhouette, quarter_turns=found.quarter_turns
        )
        for found, silhouette in zip(detections, silhouettes, strict=False)
    ]


def _is_still(track: Track, box: Box, moving: MovingRegions) -> bool:
    speed = float(np.hypot(*track.motion.velocity)) / box.height
    return speed < _STILL_SPEED and moving.moving_share(box) < _STILL_SHARE


def _is_cut(box: Box, part: Box, frame_shape: tuple[int, ...]) -> bool:
    """Whether somebody ends where the part of the frame does, but the frame goes on."""
    height, width = frame_shape[:2]
    return (
        (part.x > 0 and box.x < part.x + _CUT_PX)
        or (part.y > 0 and box.y < part.y + _CUT_PX)
        or (part.right < width - 1 and box.right > part.right - _CUT_PX)
        or (part.bottom < height - 1 and box.bottom > part.bottom - _CUT_PX)
    )


def _around(boxes: Sequence[Box]) -> Box:
    """A box about others, with room for people to be larger than expected."""
    room = _ROOM * max(box.height for box in boxes)
    left, top = min(box.x for box in boxes) - room, min(box.y for box in boxes) - room
    right, bottom = max(box.right for box in boxes) + room, max(box.bottom for box in boxes) + room
    return Box(left, top, right - left, bottom - top)


def _touching(boxes: Sequence[Box]) -> list[list[int]]:
    """Positions of boxes, grouped by those that overlap with some room about them."""
    enlarged = [_around([box]) for box in boxes]
    corners = np.array([[b.x, b.y, b.width, b.height] for b in enlarged]).reshape(-1, 4)
    touching = intersections(corners, corners) > 0
    left = list(range(len(boxes)))
    groups = []
    while left:
        group = [left.pop(0)]
        for member in group:  # Grows while it is gone through.
            group += [i for i in left if touching[member, i]]
            left = [i for i in left if i not in group]
        groups.append(group)
    return groups
