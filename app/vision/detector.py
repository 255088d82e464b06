"""Detection of people with both networks and, beside them, HOG.

MoveNet sees the whole frame once. If the smallest wanted person would be too small in it, MoveNet
sees the frame again at a higher resolution, in tiles. Where a person is doubtful, a detector of
objects compares the person with animals and furniture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import BlazePoseDetection, BlazePoseDetector, LandmarkNetwork
from app.vision.geometry import (
    Box,
    PersonWindow,
    PixelRect,
    box_array,
    crop,
    non_max_suppression,
    shrink_quickly,
)
from app.vision.models import fitted_constants
from app.vision.movenet import MoveNet
from app.vision.odds import logit, sigmoid
from app.vision.people import Detection
from app.vision.person_reader import trunk_roll_deg
from app.vision.rescoring import PERSON_PX, ObjectNetwork, hog_margin

MIN_DETECTION_SCORE = 0.3
"""Probability from which a detection is reported by default."""

# Log odds added to a detection where a person was seen a moment ago. People do not vanish, but a
# falling person is blurred, and then lies in a pose that detectors rarely recognise.
_EXPECTED_LOG_ODDS = 1.0
# Longer side of a box, in the overview, from which people are taken from the overview; smaller ones
# are taken from the tiles, which separate two people side by side.
_LARGE_PERSON_PX = 96.0
_SEAM_PX = 4.0  # A box that ends so close to a seam, as MoveNet sees it, is cut.
# Overlap from which two boxes show one person; two people side by side reach 0.3.
_NMS_IOU = 0.4
DOUBTFUL = (0.2, 0.8)
"""Probabilities between which a detection is compared with other objects."""

# Side of the window in which a detection is compared, relative to the longer side of the box, and
# the turn of the trunk from which it is also compared upright: the network hardly knows people who
# lie.
_OBJECT_WINDOW_SCALE, _MIN_TURN_DEG = 1.8, 45.0
# Overlap from which a detection is a person known already.
_KNOWN_IOU = 0.3
# Probability from which a detection close to others may be a person whom they partly hide.
_MIN_HIDDEN_PROBABILITY = 0.15
_MIN_MOVENET_SCORE = 0.02  # MoveNet's lower scores are ignored.
_MIN_BODY_SCORE = 0.3  # Least score of BlazePose's detector.
# Presence from which a detection of BlazePose alone is a person: walls and trees stay below 0.1,
# most people are above 0.9.
_MIN_PRESENCE = 0.5


class NetworkDetector:
    """Find people with MoveNet and BlazePose's detector; thread-safe.

    MoveNet finds people of any size, BlazePose's detector large people in any pose and orientation.
    HOG may raise a score but never lowers it, since it recognises only standing people.

    Parameters
    ----------
    landmarks : LandmarkNetwork
        Confirms people that MoveNet misses.
    objects : ObjectNetwork
        Compares doubtful people with other objects.
    min_person_px : float, optional
        Height of the smallest person wanted, in pixels; by default a share of the frame's height.
    min_score : float
        Probability from which a person is reported.
    """

    def __init__(
        self,
        movenet: MoveNet,
        body_detector: BlazePoseDetector,
        landmarks: LandmarkNetwork,
        objects: ObjectNetwork,
        *,
        min_person_px: float | None = None,
        min_score: float = MIN_DETECTION_SCORE,
    ) -> None:
        self._movenet = movenet
        self._body_detector = body_detector
        self._landmarks = landmarks
        self._objects = objects
        self._min_score = min_score
        self._min_person_px = min_person_px
        if min_person_px is not None and not min_person_px > 0:
            raise ValueError(f"expected a positive min_person_px, got {min_person_px}")
        if not 0 <= min_score <= 1:
            raise ValueError(f"expected a min_score from 0 to 1, got {min_score}")

    def detect(
        self,
        frame: NDArray[np.uint8],
        expected_boxes: Sequence[Box] = (),
        known_boxes: Sequence[Box] = (),
    ) -> list[Detection]:
        """Find the people of a frame ``(H, W, 3)``, BGR; best first, those not certain last.

        ``expected_boxes`` surround people who were there a moment ago and were not seen to leave,
        ``known_boxes`` people who need no comparison with other objects.
        """
        detections, scores = self._candidates(frame)
        odds = detection_odds(scores)
        for row, (one, probability) in enumerate(zip(detections, sigmoid(odds), strict=True)):
            known = any(one.box.iou(other) >= _KNOWN_IOU for other in known_boxes)
            if one.certain and DOUBTFUL[0] <= probability < DOUBTFUL[1] and not known:
                gain = object_odds(*self.object_log_odds(frame, one))
                # Those hardly seen beside others look like part of them.
                odds[row] += gain if probability >= self._min_score else max(0.0, gain)
        for box in expected_boxes:
            near = [i for i, one in enumerate(detections) if one.certain and _may_be(one.box, box)]
            if near:
                odds[max(near, key=lambda i: odds[i])] += _EXPECTED_LOG_ODDS
        judged = [
            replace(one, score=score, certain=one.certain and score >= self._min_score)
            for one, score in zip(detections, sigmoid(odds).tolist(), strict=True)
        ]
        certain = [one for one in judged if one.certain]
        close = [
            one
            for one in judged
            if not one.certain
            and one.score >= _MIN_HIDDEN_PROBABILITY
            and any(one.box.intersection(other.box) > 0 for other in certain)
        ]
        return [
            one for part in (certain, close) for one in sorted(part, key=lambda one: -one.score)
        ]

    def candidates(self, frame: NDArray[np.uint8]) -> tuple[list[Detection], NDArray[np.float64]]:
        """Find all candidates of both networks, however low their score.

        Returns
        -------
        detections : list of Detection
            One for each person, with MoveNet's score and the windows of BlazePose's detector.
        scores : (N, 3) float64 array
            MoveNet's score, HOG's margin, and the score of BlazePose's detector; 0 where a network
            detects nobody.
        """
        found, scores = self._candidates(frame)
        rows = [row for row, one in enumerate(found) if one.certain]
        return [found[row] for row in rows], scores[rows]

    def object_log_odds(self, frame: NDArray[np.uint8], one: Detection) -> tuple[float, float]:
        """As :meth:`ObjectNetwork.log_odds`, upright or as the trunk is turned."""
        roll = one.windows[0].roll_deg if one.windows else trunk_roll_deg(one.keypoints)
        rolls = [0.0] if roll is None or abs(roll) < _MIN_TURN_DEG else [0.0, roll]
        side = _OBJECT_WINDOW_SCALE * max(one.box.width, one.box.height)
        windows = [replace(PersonWindow.about_box(one.box, roll), side=side) for roll in rolls]
        return max(self._objects.log_odds(frame, window) for window in windows)

    def _candidates(self, frame: NDArray[np.uint8]) -> tuple[list[Detection], NDArray[np.float64]]:
        """The same, with others in their boxes, who are not certain."""
        height, width = frame.shape[:2]
        tiles = tiles_of(width, height, self._min_person_px)
        if not tiles:
            return [], np.zeros((0, 3))
        overview = shrink_quickly(frame, *tiles[0].size)
        found = self._movenet_people(frame, overview, tiles)
        windows: list[list[PersonWindow]] = [[] for _ in found]
        factor = tiles[0].factor
        scores = [[one.score, _margin(frame, overview, factor, one.box), 0.0] for one in found]
        alone: list[Detection] = []
        # An enlarged overview shows no more than the frame.
        picture, scale = (frame, 1.0) if factor > 1 else (overview, factor)
        for seen in self._body_detector.detect(picture, _MIN_BODY_SCORE):
            body = replace(seen, window=seen.window.scaled(1 / scale))
            same = [
                i for i, one in enumerate(found) if one.certain and _is_same(body.window, one.box)
            ]
            if same:
                best = max(same, key=lambda i: found[i].score)
                windows[best].append(body.window)
                scores[best][2] = max(scores[best][2], body.score)
            elif (person := self._confirmed(frame, body)) is not None:
                alone.append(person)
                scores.append([0.0, 0.0, body.score])
        both = [replace(one, windows=tuple(own)) for one, own in zip(found, windows, strict=True)]
        return [*both, *alone], np.array(scores, np.float64).reshape(-1, 3)

    def _movenet_people(
        self, frame: NDArray[np.uint8], overview: NDArray[np.uint8], tiles: Sequence[Tile]
    ) -> list[Detection]:
        """MoveNet's detections in the overview and the other tiles, one a person, best first.

        Last come others in the boxes of these whose keypoints differ; they are not certain.
        """
        height, width = frame.shape[:2]
        found: list[Detection] = []
        ranks: list[float] = []
        for number, tile in enumerate(tiles):
            picture = (
                overview if number == 0 else shrink_quickly(crop(frame, tile.rect), *tile.size)
            )
            for person in self._movenet.detect(picture):
                box = tile.to_frame(person.box, width, height, _SEAM_PX)
                if box is None or person.score < _MIN_MOVENET_SCORE:
                    continue
                score = min(1.0, person.score)
                keypoints = person.keypoints.scaled(1 / tile.factor).moved(*tile.rect[:2])
                found.append(Detection(box, score, keypoints))
                overview_px = max(box.width, box.height) * tiles[0].factor
                is_large = overview_px >= _LARGE_PERSON_PX
                # A box from the more suitable resolution comes before all others.
                ranks.append(score + (len(tiles) == 1 or is_large == (number == 0)))
        boxes = box_array(one.box for one in found)
        kept = [found[i] for i in non_max_suppression(boxes, np.array(ranks), _NMS_IOU)]
        people = list(kept)
        for one, _ in sorted(zip(found, ranks, strict=True), key=lambda pair: -pair[1]):
            if not any(one is other or _is_same_person(one, other) for other in people):
                people.append(replace(one, certain=False))
        return people

    def _confirmed(self, frame: NDArray[np.uint8], body: BlazePoseDetection) -> Detection | None:
        """A body that MoveNet misses, if the landmark network sees a person there."""
        reading = self._landmarks.read(frame, body.window)
        box = reading.landmarks.box().clip(frame.shape[1], frame.shape[0])
        if box is None or reading.presence < _MIN_PRESENCE:
            return None
        return Detection(box, 0.0, None, (body.window,))


def _margin(
    frame: NDArray[np.uint8], overview: NDArray[np.uint8], factor: float, box: Box
) -> float:
    """HOG's margin on a box, by the overview where the box is large enough in it."""
    seen = box.scaled(factor)
    return hog_margin(overview, seen) if seen.height >= PERSON_PX else hog_margin(frame, box)


def _is_same_person(one: Detection, other: Detection) -> bool:
    """Whether two detections of MoveNet show the same person."""
    if one.box.intersection(other.box) == 0 or one.keypoints is None or other.keypoints is None:
        return False
    size = math.sqrt(min(one.box.area, other.box.area))
    return one.keypoints.agree_with(other.keypoints, size)


# Size of BlazePose's window relative to the one about MoveNet's box if both show one person.
_SAME_SIZE = (0.4, 2.5)


def _is_same(window: PersonWindow, box: Box) -> bool:
    """Whether a body's window and a box belong to the same person."""
    inside = box.x <= window.x <= box.right and box.y <= window.y <= box.bottom
    low, high = _SAME_SIZE
    return inside and low < window.side / PersonWindow.about_box(box).side < high


# Share of a box that must be within reach of the expected person.
_MIN_EXPECTED_SHARE = 0.5


def _may_be(box: Box, expected: Box) -> bool:
    """Whether a box may hold an expected person, standing there or on the ground nearby."""
    x, y, width, height = expected.x, expected.y, expected.width, expected.height
    margin = max(width, height) / 2
    reach = Box(x - margin, y, width + 2 * margin, height + margin / 2)
    return box.intersection(reach) >= _MIN_EXPECTED_SHARE * box.area


_FITTED = fitted_constants("detection")
_WEIGHTS = np.array([_FITTED[name] for name in ("movenet", "hog", "pose_detection")])
_OFFSET = _FITTED["offset"]


def detection_odds(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log odds ``(N,)`` that candidates are people, from their scores ``(N, 3)``."""
    return detection_features(scores) @ _WEIGHTS + _OFFSET


_OBJECTS = fitted_constants("objects")


def object_odds(person: float, other: float) -> float:
    """Log odds that a doubtful detection gains or loses by the log odds of objects."""
    excess = max(0.0, other - person)
    return float(_OBJECTS["person"] * person + _OBJECTS["excess"] * excess + _OBJECTS["offset"])


# Least distance of scores from 0 and 1 when their log odds are taken.
_MIN_PROBABILITY = 1e-4


def detection_features(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Features ``(N, 3)`` of the fitted probability, from :meth:`NetworkDetector.candidates`.

    They are MoveNet's log odds, HOG's margin if positive, and the score of BlazePose's detector.
    """
    movenet, margin, body = scores.T
    odds = logit(np.maximum(movenet, _MIN_MOVENET_SCORE), _MIN_PROBABILITY)
    return np.stack([odds, np.maximum(0.0, margin), body], axis=1)


@dataclass(frozen=True)
class Tile:
    """A part of a frame as MoveNet sees it.

    Parameters
    ----------
    rect : (left, top, width, height)
        In pixels of the frame.
    factor : float
        Factor by which the part is resized.
    """

    rect: PixelRect
    factor: float

    @property
    def size(self) -> tuple[int, int]:
        """Width and height after resizing, in pixels."""
        _, _, width, height = self.rect
        return max(1, round(width * self.factor)), max(1, round(height * self.factor))

    def to_frame(self, box: Box, width: int, height: int, seam_px: float) -> Box | None:
        """A box of this tile in pixels of the frame.

        None if it lies outside the frame, or ends within ``seam_px`` of an edge of the tile that is
        not an edge of the frame, since such a person is cut off.
        """
        left, top, columns, rows = self.rect
        seam = seam_px / self.factor
        whole = box.scaled(1 / self.factor)
        is_cut = (
            (left > 0 and whole.x < seam)
            or (top > 0 and whole.y < seam)
            or (left + columns < width and whole.right > columns - seam)
            or (top + rows < height and whole.bottom > rows - seam)
        )
        if is_cut:
            return None
        return Box(whole.x + left, whole.y + top, whole.width, whole.height).clip(width, height)


OVERVIEW_PX = (640, 352)
"""Largest sides of the overview: a camera with more pixels does not cost more."""

MAX_ENLARGEMENT = 1.5
"""Largest factor by which small frames are enlarged."""

MIN_SIDE_PX = 12
"""Shortest side of the overview; thinner frames hold nobody."""

# Height of the smallest person wanted by default, as a share of the frame's height.
_MIN_PERSON_SHARE = 1 / 12

MIN_PERSON_PX = OVERVIEW_PX[1] * _MIN_PERSON_SHARE
"""Height at which MoveNet sees the smallest wanted person."""

MIN_GAIN = 1.1
"""Gain in resolution over the overview up to which tiles add nothing."""

MAX_FINE_SIDE_PX, MAX_FINE_PX = 1280, 1280 * 720
"""Largest side and area of the frame at the resolution of the tiles; they bound the time."""


def smallest_person_px(frame_shape: tuple[int, ...], min_person_px: float | None) -> float:
    """Height of the smallest person wanted, in pixels: a share of the frame's unless given."""
    if min_person_px is not None:
        return min_person_px
    return max(1.0, _MIN_PERSON_SHARE * frame_shape[0])


def tiles_of(width: int, height: int, min_person_px: float | None = None) -> list[Tile]:
    """The overview of a frame, and tiles at a higher resolution if small people are wanted.

    Parameters
    ----------
    width, height : int
        Of the frame, in pixels.
    min_person_px : float, optional
        Height of the smallest person wanted, in pixels of the frame; by default a share of its
        height, for which the overview is enough.

    Returns
    -------
    list of Tile
        The overview first; empty for a frame too thin to hold a person.
    """
    # Portrait frames are seen as large as landscape frames.
    longer, shorter = max(width, height), min(width, height)
    long_px, short_px = OVERVIEW_PX
    overview = min(long_px / longer, short_px / shorter, MAX_ENLARGEMENT)
    if shorter * overview < MIN_SIDE_PX:
        return []
    whole = Tile((0, 0, width, height), overview)
    if min_person_px is None:
        return [whole]
    fine = min(
        MAX_FINE_SIDE_PX / longer,
        math.sqrt(MAX_FINE_PX / (width * height)),
        MIN_PERSON_PX / min_person_px,
    )
    if fine <= MIN_GAIN * overview:
        return [whole]
    return [whole, *(Tile(rect, fine) for rect in _grid(width, height, fine))]


MAX_TILE_PX = 160_000
"""Area of a tile as MoveNet sees it, which bounds the memory."""

_MAX_TILES_PER_SIDE = 8
# Overlap of tiles, so that a person at a seam is whole in the next tile or the overview.
_OVERLAP_PX = 96


def _grid(width: int, height: int, factor: float) -> list[PixelRect]:
    """Overlapping tiles, small enough when resized by ``factor``, with the smallest total area."""
    overlap = _OVERLAP_PX / factor
    counts = range(1, _MAX_TILES_PER_SIDE + 1)
    widths = {columns: _part(width, columns, overlap) for columns in counts}
    heights = {rows: _part(height, rows, overlap) for rows in counts}
    _, columns, rows = min(
        (columns * widths[columns] * rows * heights[rows], columns, rows)
        for columns in counts
        for rows in counts
        if widths[columns] * heights[rows] * factor**2 <= MAX_TILE_PX
    )
    return [
        (left, top, right - left, bottom - top)
        for top, bottom in _spans(height, rows, overlap)
        for left, right in _spans(width, columns, overlap)
    ]


def _part(length: int, count: int, overlap: float) -> float:
    """Length of each of ``count`` overlapping parts."""
    return (length + (count - 1) * overlap) / count


def _spans(length: int, count: int, overlap: float) -> list[tuple[int, int]]:
    part = _part(length, count, overlap)
    starts = [round(i * (part - overlap)) for i in range(count)]
    return [(start, min(length, math.ceil(start + part))) for start in starts]
