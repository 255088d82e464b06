"""The detectors: two networks with HOG beside them, and HOG alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision import DetectorName
from app.vision.blazepose import BlazePoseDetection, LandmarkNetwork, PoseDetection
from app.vision.boxes import Boxes, averaged, drop_parts, suppress
from app.vision.geometry import Box, Detection, PersonWindow
from app.vision.hog import person_margin, person_windows
from app.vision.models import fitted
from app.vision.movenet import MoveNet
from app.vision.odds import logit, sigmoid
from app.vision.tiles import LONGEST_PX, SMALLEST_SHARE, Tile, tiles_of
from app.vision.windows import cut, resize, window_about

MIN_SCORE, HOG_MIN_SCORE = 0.3, 0.2
"""Defaults of the least probability reported, by the networks and by HOG alone."""

SAME_PERSON = 0.4
"""Overlap (IoU) from which two boxes are one person: two people walking together reach 0.3."""

LOST_ODDS = 1.0
"""Log odds that somebody is where a person was seen a moment ago: people do not vanish. Who falls
is blurred, then lies as detectors hardly know people."""

# People at least this high as shown are best found in the overview, smaller ones in the tiles,
# which tell apart two people walking together.
_LARGE_PX = 96
# Boxes that end within this many pixels, as shown, of a tile's edge inside the frame are cut by it.
_CUT_PX = 4.0
_LEAST_NETWORK_SCORE = 0.02
# HOG enlarges a frame no further than to find people as small as this, in pixels: in a frame of a
# few rows a share of its height would be next to nothing.
_LEAST_HOG_PX = 16.0
# Scores of BlazePose's detector from which a body is looked at, and the landmark network's presence
# from which it is a person: walls and trees stay below 0.1, people mostly above 0.9.
_LEAST_BODY_SCORE, _LEAST_PRESENCE = 0.3, 0.5
# Sizes of a body's circle relative to its box at which both are about one person.
_SAME_SIZE = (0.4, 2.5)


class Detector(Protocol):
    """A frame to people; implementations are thread-safe."""

    name: DetectorName

    def detect(self, frame: NDArray[np.uint8], lost: Sequence[Box] = ()) -> list[Detection]:
        """Find the people.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        lost : sequence of Box
            Where somebody was seen a moment ago who was not seen to leave.

        Returns
        -------
        list of Detection
            Best first.
        """
        ...


class NetworkDetector:
    """Find people by MoveNet and by BlazePose's detector.

    MoveNet finds people of any size, BlazePose's detector large ones in any pose and orientation.
    HOG's opinion may raise a score, never lower it: it only knows people who stand.

    Parameters
    ----------
    movenet : MoveNet
    pose_detection : PoseDetection
    landmarks : LandmarkNetwork
        Confirms people whom MoveNet does not see.
    min_person_px : float, optional
        Height of the smallest person wanted, in pixels; by default a share of the frame's height.
    min_score : float
        Least probability reported.
    """

    name: DetectorName = "network"

    def __init__(
        self,
        movenet: MoveNet,
        pose_detection: PoseDetection,
        landmarks: LandmarkNetwork,
        *,
        min_person_px: float | None = None,
        min_score: float = MIN_SCORE,
    ) -> None:
        self._movenet = movenet
        self._pose_detection = pose_detection
        self._landmarks = landmarks
        self._min_person_px = _checked(min_person_px, min_score)
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8], lost: Sequence[Box] = ()) -> list[Detection]:
        """Find the people; see :class:`Detector`."""
        detections, scores = self.candidates(frame)
        odds = detection_odds(scores)
        for box in lost:
            near = [i for i, one in enumerate(detections) if _is_near(one.box, box)]
            if near:
                odds[max(near, key=lambda i: odds[i])] += LOST_ODDS
        probabilities = sigmoid(odds).tolist()
        found = [
            replace(detection, score=probability)
            for detection, probability in zip(detections, probabilities, strict=True)
        ]
        return _best_first(found, self._min_score)

    def candidates(self, frame: NDArray[np.uint8]) -> tuple[list[Detection], NDArray[np.float64]]:
        """Find all candidates of both networks, however low their score.

        Returns
        -------
        detections : list of Detection
            One for each person, with MoveNet's score and the windows of BlazePose's detector.
        scores : (N, 3) float64 array
            MoveNet's score, HOG's margin on the box's window, and the score of BlazePose's
            detector; 0 where a network sees nobody.
        """
        found = self._people(frame)
        windows: list[list[PersonWindow]] = [[] for _ in found]
        scores = [[one.score, person_margin(frame, one.box), 0.0] for one in found]
        alone: list[Detection] = []
        for body in self._pose_detection.bodies(frame, _LEAST_BODY_SCORE):
            near = [i for i, one in enumerate(found) if _is_about(body.window, one.box)]
            if near:
                best = max(near, key=lambda i: found[i].score)
                windows[best].append(body.window)
                scores[best][2] = max(scores[best][2], body.score)
            elif (person := self._confirmed(frame, body)) is not None:
                alone.append(person)
                scores.append([0.0, 0.0, body.score])
        seen = [replace(one, windows=tuple(own)) for one, own in zip(found, windows, strict=True)]
        return [*seen, *alone], np.array(scores, np.float64).reshape(-1, 3)

    def _people(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """The people whom MoveNet sees, one for each, best first."""
        height, width = frame.shape[:2]
        tiles = tiles_of(width, height, self._min_person_px)
        found: list[Detection] = []
        preferred: list[bool] = []
        for number, tile in enumerate(tiles):
            picture = resize(cut(frame, tile.window), *tile.size)
            for person in self._movenet.people(picture):
                box = _in_frame(person.box, tile, width, height)
                if box is None or person.score < _LEAST_NETWORK_SCORE:
                    continue
                large = max(box.width, box.height) * tiles[0].factor >= _LARGE_PX
                keypoints = person.keypoints.scaled(1 / tile.factor).moved(*tile.window[:2])
                found.append(Detection(box, min(1.0, person.score), keypoints))
                preferred.append(len(tiles) == 1 or large == (number == 0))
        return [found[i] for i in _suppressed(found, preferred)]

    def _confirmed(self, frame: NDArray[np.uint8], body: BlazePoseDetection) -> Detection | None:
        """A person whom MoveNet does not see, where the landmark network sees one."""
        reading = self._landmarks.read(frame, body.window)
        box = reading.landmarks.box().clip(frame.shape[1], frame.shape[0])
        if box is None or reading.presence < _LEAST_PRESENCE:
            return None
        return Detection(box, 0.0, None, (body.window,))


class HogDetector:
    """Find upright people by HOG alone; needs no network.

    Parameters
    ----------
    min_person_px, min_score : float
        As in :class:`NetworkDetector`.
    """

    name: DetectorName = "hog"

    def __init__(
        self, *, min_person_px: float | None = None, min_score: float = HOG_MIN_SCORE
    ) -> None:
        self._min_person_px = _checked(min_person_px, min_score)
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8], lost: Sequence[Box] = ()) -> list[Detection]:
        """Find the people; see :class:`Detector`."""
        height, width = frame.shape[:2]
        boxes, margins = self.people(frame)
        constants = fitted("detection")
        scores = sigmoid(constants["hog_alone"] * margins + constants["hog_alone_offset"])
        detections = [
            Detection(inside, float(score))
            for box, score in zip(boxes, scores, strict=True)
            if (inside := Box(*box.tolist()).clip(width, height)) is not None
        ]
        return _best_first(detections, self._min_score)

    def people(self, frame: NDArray[np.uint8]) -> tuple[Boxes, NDArray[np.float64]]:
        """One box for each person, and its margin; see :func:`hog_people`."""
        height, width = frame.shape[:2]
        smallest = max(_LEAST_HOG_PX, smallest_person_px(frame.shape, self._min_person_px))
        factor = min(1.0, 50 / smallest, LONGEST_PX / max(height, width))
        small = resize(frame, max(1, round(width * factor)), max(1, round(height * factor)))
        boxes, margins = hog_people(small, max(min(50, smallest), 50 * factor))
        boxes[:, :2] = (boxes[:, :2] + 0.5) / factor - 0.5
        boxes[:, 2:] /= factor
        return boxes, margins


def hog_people(frame: NDArray[np.uint8], min_person_px: float) -> tuple[Boxes, NDArray[np.float64]]:
    """One box for each person that HOG finds.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR, at the resolution to search.
    min_person_px : float
        Height of the smallest person wanted, in pixels.

    Returns
    -------
    boxes : (K, 4) float64 array
        x, y, width, height; best first.
    margins : (K,) float64 array
        Distance from the decision boundary, positive.
    """
    boxes, margins = person_windows(frame, min_person_px, threshold=0.0)
    if len(boxes) == 0:
        return boxes, margins
    kept = drop_parts(boxes, suppress(boxes, margins, SAME_PERSON))
    return averaged(boxes, margins + 0.1, kept), margins[kept]


def detection_odds(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log odds ``(N,)`` that candidates are people, from their scores ``(N, 3)``."""
    constants = fitted("detection")
    weights = np.array([constants[name] for name in ("movenet", "hog", "pose_detection")])
    return np.asarray(detection_features(scores) @ weights + constants["offset"])


def detection_features(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the probability is made of, ``(N, 3)``, from :meth:`NetworkDetector.candidates`.

    MoveNet's log odds, HOG's margin where it sees a person, the score of BlazePose's detector.
    """
    movenet, margin, body = scores.T
    odds = logit(np.maximum(movenet, _LEAST_NETWORK_SCORE), least=1e-4)
    return np.stack([odds, np.maximum(0.0, margin), body], axis=1)


def _in_frame(box: Box, tile: Tile, width: int, height: int) -> Box | None:
    """A tile's box in pixels of the frame; None if the tile's edge cuts the person."""
    left, top, columns, rows = tile.window
    reach = _CUT_PX / tile.factor
    whole = box.scaled(1 / tile.factor)
    cut_by_tile = (
        (left > 0 and whole.x < reach)
        or (top > 0 and whole.y < reach)
        or (left + columns < width and whole.right > columns - reach)
        or (top + rows < height and whole.bottom > rows - reach)
    )
    if cut_by_tile:
        return None
    return Box(whole.x + left, whole.y + top, whole.width, whole.height).clip(width, height)


def _is_near(box: Box, lost: Box) -> bool:
    """Whether somebody who was lost may be in a box: where they stood, or on the ground beside."""
    return box.intersection(_where_they_may_lie(lost)) >= 0.5 * box.area


def _where_they_may_lie(box: Box) -> Box:
    room = max(box.width, box.height) / 2
    return Box(box.x - room, box.y, box.width + 2 * room, box.height + room / 2)


def _is_about(window: PersonWindow, box: Box) -> bool:
    """Whether the window of a body is that of the person in a box."""
    inside = box.x <= window.x <= box.right and box.y <= window.y <= box.bottom
    ratio = window.side / window_about(box).side
    return inside and _SAME_SIZE[0] < ratio < _SAME_SIZE[1]


def _suppressed(found: Sequence[Detection], preferred: Sequence[bool]) -> list[int]:
    """Non-maximum suppression over all tiles, people shown at the better size first."""
    boxes = [one.box for one in found]
    corners = np.array([[b.x, b.y, b.width, b.height] for b in boxes], np.float64).reshape(-1, 4)
    scores = np.array([one.score for one in found], np.float64)
    return suppress(corners, scores + np.array(preferred, np.float64), SAME_PERSON)


def _best_first(detections: Iterable[Detection], min_score: float) -> list[Detection]:
    kept = [detection for detection in detections if detection.score >= min_score]
    return sorted(kept, key=lambda detection: -detection.score)


def smallest_person_px(shape: tuple[int, ...], min_person_px: float | None) -> float:
    """Height of the smallest wanted person of a frame, in pixels."""
    return max(1.0, SMALLEST_SHARE * shape[0]) if min_person_px is None else min_person_px


def _checked(min_person_px: float | None, min_score: float) -> float | None:
    if min_person_px is not None and not min_person_px > 0:
        raise ValueError(f"expected a positive min_person_px, got {min_person_px}")
    if not 0 <= min_score <= 1:
        raise ValueError(f"expected a min_score from 0 to 1, got {min_score}")
    return min_person_px
