"""The detectors: the network judged by HOG, and HOG alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision.boxes import Boxes, averaged, drop_parts, suppress
from app.vision.detection.hog import person_margin, person_windows
from app.vision.detection.tiles import LONGEST_PX, Tile, tiles_of
from app.vision.keypoints.movenet import MoveNet, PersonInPicture
from app.vision.people import Box, Detection
from app.vision.resampling import cut, resize
from app.vision.rotation import find_quarter_turns, rotate_box
from app.vision.weights import fitted

DetectorName = Literal["network", "hog"]

MIN_SCORE = 0.2
"""Default of the least probability reported."""

SAME_PERSON = 0.4
"""Overlap (IoU) from which two boxes are one person: two people walking together reach 0.3."""

# People at least this high as shown are best found in the overview, smaller ones in the tiles,
# which tell apart two people walking together.
_LARGE_PX = 96
# Boxes that end within this many pixels, as shown, of a tile's edge inside the frame are cut by it.
_CUT_PX = 4.0
_LEAST_NETWORK_SCORE = 0.02


class Detector(Protocol):
    """A frame to people; implementations are thread-safe."""

    name: DetectorName

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find the people.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.

        Returns
        -------
        list of Detection
            Best first.
        """
        ...


class NetworkDetector:
    """Find people by MoveNet, and let HOG judge each of them.

    Parameters
    ----------
    network : MoveNet
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    min_score : float
        Least probability reported.
    """

    name: DetectorName = "network"

    def __init__(
        self, network: MoveNet, *, min_person_px: float = 50, min_score: float = MIN_SCORE
    ) -> None:
        self._network = network
        self._min_person_px = _checked(min_person_px, min_score)
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find the people; see :class:`Detector`."""
        boxes, quarter_turns, scores = self.candidates(frame)
        probabilities = sigmoid(log_odds(scores[:, 0], scores[:, 1])).tolist()
        detections = map(Detection, boxes, probabilities, quarter_turns)
        return _best_first(detections, self._min_score)

    def candidates(
        self, frame: NDArray[np.uint8]
    ) -> tuple[list[Box], list[int], NDArray[np.float64]]:
        """Find all candidates of the network, however low their score.

        Returns
        -------
        boxes : list of Box
            One for each person, best first.
        quarter_turns : list of int
            Of each; see :class:`app.vision.people.Detection`.
        scores : (N, 2) float64 array
            The network's score, and HOG's margin on the box's window, rotated upright.
        """
        height, width = frame.shape[:2]
        tiles = tiles_of(width, height, self._min_person_px)
        found: list[tuple[Box, PersonInPicture]] = []
        preferred: list[bool] = []
        for number, tile in enumerate(tiles):
            picture = resize(cut(frame, tile.window), *tile.size)
            for person in self._network.people(picture):
                box = _in_frame(person.box, tile, width, height)
                if box is None or person.score < _LEAST_NETWORK_SCORE:
                    continue
                large = max(box.width, box.height) * tiles[0].factor >= _LARGE_PX
                found.append((box, person))
                preferred.append(len(tiles) == 1 or large == (number == 0))
        kept = [found[i] for i in _suppressed(found, preferred)]
        quarter_turns = [find_quarter_turns(person.keypoints) for _, person in kept]
        scores = [
            (person.score, person_margin(np.rot90(frame, turn), rotate_box(box, frame.shape, turn)))
            for (box, person), turn in zip(kept, quarter_turns, strict=True)
        ]
        boxes = [box for box, _ in kept]
        return boxes, quarter_turns, np.array(scores, np.float64).reshape(-1, 2)


class HogDetector:
    """Find upright people by HOG alone; needs no network.

    Parameters
    ----------
    min_person_px, min_score : float
        As in :class:`NetworkDetector`.
    """

    name: DetectorName = "hog"

    def __init__(self, *, min_person_px: float = 50, min_score: float = MIN_SCORE) -> None:
        self._min_person_px = _checked(min_person_px, min_score)
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
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
        factor = min(1.0, 50 / self._min_person_px, LONGEST_PX / max(height, width))
        small = resize(frame, max(1, round(width * factor)), max(1, round(height * factor)))
        boxes, margins = hog_people(small, max(min(50, self._min_person_px), 50 * factor))
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


def log_odds(
    network_scores: NDArray[np.float64], hog_margins: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Log odds ``(N,)`` that boxes hold a person, from the scores of both detectors."""
    constants = fitted("detection")
    return np.asarray(
        constants["network"] * logit(network_scores)
        + constants["hog"] * hog_margins
        + constants["offset"]
    )


def logit(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log odds of scores from 0 to 1, finite."""
    clipped = np.clip(scores, 1e-4, 1 - 1e-4)
    return np.asarray(np.log(clipped / (1 - clipped)))


def sigmoid(odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities of log odds."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


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


def _suppressed(
    found: Sequence[tuple[Box, PersonInPicture]], preferred: Sequence[bool]
) -> list[int]:
    """Non-maximum suppression over all tiles, people shown at the better size first."""
    boxes = np.array([[b.x, b.y, b.width, b.height] for b, _ in found], np.float64).reshape(-1, 4)
    scores = np.array([person.score for _, person in found], np.float64)
    return suppress(boxes, scores + np.array(preferred, np.float64), SAME_PERSON)


def _best_first(detections: Iterable[Detection], min_score: float) -> list[Detection]:
    kept = [detection for detection in detections if detection.score >= min_score]
    return sorted(kept, key=lambda detection: -detection.score)


def _checked(min_person_px: float, min_score: float) -> float:
    if not min_person_px > 0:
        raise ValueError(f"expected a positive min_person_px, got {min_person_px}")
    if not 0 <= min_score <= 1:
        raise ValueError(f"expected a min_score from 0 to 1, got {min_score}")
    return min_person_px
