"""People in a frame: gradients alone, or gradients and the segmentation network together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.vision.box_arrays import Boxes, averaged, drop_parts, suppress
from app.vision.evidence import by_fitness, evidence, suited, tightened
from app.vision.hog import as_cells, person_windows
from app.vision.networks import PersonNetwork
from app.vision.people import Box, Detection
from app.vision.presence import WIDE, Presence, PresenceMap, presence_maps
from app.vision.resampling import resize
from app.vision.workers import Workers

# Frames are searched at most this large: time and memory stay bounded whatever is sent, and
# people under a 25th of a large frame's side are not looked for.
_MAX_SIDE = 1280
# Height at which the smallest wanted person is searched for: both detectors need these pixels.
_SEARCHED_PERSON_PX = 50


class Detector(Protocol):
    """A frame to people; implementations are safe under several threads."""

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


class HogDetector:
    """Find people by gradients alone; needs no model file, holds no state.

    Parameters
    ----------
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    min_score : float
        Least probability reported.
    """

    def __init__(self, *, min_person_px: float = 50, min_score: float = 0.25) -> None:
        self._min_person_px = _checked(min_person_px, min_score)
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find the people; see :class:`Detector`."""
        small, factor, person_px = _searched(frame, self._min_person_px)
        boxes, margins = gradient_detections(small, person_px)
        scores = probability(_HOG_SLOPE * margins + _HOG_OFFSET)
        return _detections(boxes, scores, frame.shape, factor, self._min_score)


def gradient_detections(
    frame: NDArray[np.uint8], min_person_px: float
) -> tuple[Boxes, NDArray[np.float64]]:
    """One box for each person that gradients find.

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
        Distance from the classifier's border, positive.
    """
    boxes, margins = person_windows(frame, min_person_px, threshold=0.0)
    if len(boxes) == 0:
        return boxes, margins
    kept = drop_parts(boxes, suppress(boxes, margins, _SAME_PERSON))
    return averaged(boxes, margins + 0.1, kept), margins[kept]


class CascadeDetector:
    """Find people by gradients and the segmentation network together.

    The network tells where people are but not one from another; gradients propose boxes
    there. Each box is tightened to what the network saw in it and judged by a logistic
    regression on a few features of both.

    Parameters
    ----------
    network : PersonNetwork
    min_person_px, min_score : float
        As in :class:`HogDetector`.
    workers : Workers, optional
        Who searches for people of several sizes; by default the caller's thread.
    """

    def __init__(
        self,
        network: PersonNetwork,
        *,
        min_person_px: float = 50,
        min_score: float = 0.3,
        workers: Workers | None = None,
    ) -> None:
        self._network = network
        self._workers = workers
        self._min_person_px = _checked(min_person_px, min_score)
        self._min_score = min_score

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find the people; see :class:`Detector`."""
        return self.look(frame)[0]

    def look(self, frame: NDArray[np.uint8]) -> tuple[list[Detection], Presence]:
        """Find the people, and tell where the network saw somebody."""
        small, factor, person_px = _searched(frame, self._min_person_px)
        maps = presence_maps(self._network, small, person_px)
        presence = Presence(maps, factor, person_px)
        boxes, features = candidates(maps, small, person_px, self._workers)
        if len(boxes) == 0:
            return [], presence
        odds = features @ _WEIGHTS + _OFFSET
        means, kept = merge(boxes, odds)
        scores = probability(_CALIBRATION_SLOPE * odds[kept] + _CALIBRATION_OFFSET)
        return _detections(means, scores, frame.shape, factor, self._min_score), presence


# Overlap from which two boxes are one person: two people walking together reach 0.3.
_SAME_PERSON = 0.4
# Proposals by gradients that are followed up.
_MOST_PROPOSALS = 25
_PROPOSAL_OVERLAP = 0.7
_PROPOSAL_THRESHOLD = -0.8
_SLIGHTEST_PRESENCE = 0.05
# How much full presence inside a window counts in the classifier's units.
_PRESENCE_GAIN = 3.0


def candidates(
    maps: Sequence[PresenceMap],
    frame: NDArray[np.uint8],
    min_person_px: float,
    workers: Workers | None = None,
) -> tuple[Boxes, NDArray[np.float64]]:
    """Boxes that may hold a person, several for each, with the features that judge them.

    Parameters
    ----------
    maps : sequence of PresenceMap
        Of the frame.
    frame : (H, W, 3) uint8 array
        BGR, at the resolution to search.
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    workers : Workers, optional
        See :func:`app.vision.hog.person_windows`.

    Returns
    -------
    boxes : (N, 4) float64 array
        x, y, width, height.
    features : (N, 14) float64 array
        See :data:`app.vision.evidence.NAMES`.
    """
    anybody = {one.side: as_cells(one.probability > _SLIGHTEST_PRESENCE) for one in maps}

    def worth_searching(person_px: float) -> NDArray[np.bool_]:
        cells = [anybody[one.side] for one in suited(maps, person_px)]
        return np.asarray(np.any(cells, axis=0))

    windows, scores = person_windows(
        frame, min_person_px, _PROPOSAL_THRESHOLD, worth_searching, workers
    )
    boxes = _proposed_by_gradients(maps, windows, scores) + _proposed_by_presence(
        maps, 0.6 * min_person_px
    )
    stacked = np.array(boxes, np.float64).reshape(-1, 4)
    return stacked, evidence(maps, stacked, windows, scores)


def merge(boxes: Boxes, odds: NDArray[np.float64]) -> tuple[Boxes, list[int]]:
    """One box for each person out of many candidates.

    Parameters
    ----------
    boxes : (N, 4) float64 array
    odds : (N,) float64 array
        Log odds that the box is right.

    Returns
    -------
    boxes : (K, 4) float64 array
        Means of the candidates of each person.
    kept : list of int
        The best candidate of each, best first.
    """
    kept = drop_parts(boxes, suppress(boxes, odds, _SAME_PERSON))
    return averaged(boxes, probability(odds), kept), kept


def _proposed_by_gradients(
    maps: Sequence[PresenceMap], windows: Boxes, scores: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Windows, each also tightened to the presence in it: in height alone and both ways."""
    if len(windows) == 0:
        return []
    presence = np.array([_mean_inside(by_fitness(maps, box[3])[0], box) for box in windows])
    rank = scores + _PRESENCE_GAIN * presence
    boxes = []
    for index in suppress(windows, rank, _PROPOSAL_OVERLAP)[:_MOST_PROPOSALS]:
        box = windows[index]
        boxes.append(box)
        tight = tightened(by_fitness(maps, box[3])[0], box)
        if tight is None:
            continue
        width = float(np.clip(tight[2], 0.25 * tight[3], 0.5 * tight[3]))
        upright = np.array([box[0] + (box[2] - width) / 2, tight[1], width, tight[3]])
        boxes += [tight, upright]
    return boxes


def _proposed_by_presence(
    maps: Sequence[PresenceMap], least_height: float
) -> list[NDArray[np.float64]]:
    """Boxes of connected presence, at several levels, that stand upright."""
    boxes = []
    for presence in maps:
        windows = np.array([one.window for one in presence.pieces], np.float64).reshape(-1, 4)
        width, height = windows[:, 2], windows[:, 3]
        upright = windows[(height > least_height) & (width < WIDE * height)]
        boxes += list(upright - (0.5, 0.5, 0, 0))
    return boxes


def _mean_inside(presence: PresenceMap, box: NDArray[np.float64]) -> float:
    left, top, right, bottom = Box(*box.tolist()).pixels()
    inside = presence.probability[max(0, top) : max(0, bottom), max(0, left) : max(0, right)]
    return float(inside.mean()) if inside.size else 0.0


# Fitted to real/pennfudan by `python -m scripts.evaluate real --fit-detector`, which also
# cross-validates.
_WEIGHTS = np.array(
    [
        -3.690,  # trunk
        0.382,  # beside
        -2.635,  # above
        -2.212,  # below
        3.191,  # head
        2.269,  # feet
        4.164,  # shape
        3.489,  # trunk_other
        -4.278,  # beside_other
        -0.137,  # above_other
        -2.085,  # below_other
        1.214,  # hog
        1.026,  # hog_support
        -1.212,  # aspect
    ]
)
_OFFSET = -5.290
_CALIBRATION_SLOPE, _CALIBRATION_OFFSET = 0.991, -0.136
_HOG_SLOPE, _HOG_OFFSET = 2.967, -3.715


def log_odds(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities between 0 and 1 to the logarithms of their odds."""
    return np.asarray(np.log(probabilities / (1 - probabilities)))


def probability(odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithms of odds to probabilities."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def _checked(min_person_px: float, min_score: float) -> float:
    if not min_person_px > 0:
        raise ValueError(f"expected a positive min_person_px, got {min_person_px}")
    if not 0 <= min_score <= 1:
        raise ValueError(f"expected a min_score from 0 to 1, got {min_score}")
    return min_person_px


def _searched(
    frame: NDArray[np.uint8], min_person_px: float
) -> tuple[NDArray[np.uint8], float, float]:
    """Frame at the resolution that the smallest wanted person needs.

    Returns
    -------
    frame : (h, w, 3) uint8 array
    factor : float
        By which it was resized; at most 1.
    min_person_px : float
        Height of the smallest person in it.
    """
    height, width = frame.shape[:2]
    factor = min(1.0, _SEARCHED_PERSON_PX / min_person_px, _MAX_SIDE / max(height, width))
    if factor < 1:
        frame = resize(frame, max(1, round(width * factor)), max(1, round(height * factor)))
    return frame, factor, max(min(_SEARCHED_PERSON_PX, min_person_px), min_person_px * factor)


def _detections(
    boxes: Boxes,
    scores: NDArray[np.float64],
    frame_shape: tuple[int, ...],
    factor: float,
    min_score: float,
) -> list[Detection]:
    """Return detections in pixels of the whole frame, best first."""
    found = []
    for box, score in zip(boxes, scores, strict=True):
        whole = Box(*box.tolist()).scaled(1 / factor).clip(frame_shape[1], frame_shape[0])
        if whole is not None and score >= min_score:
            found.append(Detection(whole, float(score)))
    return sorted(found, key=lambda detection: -detection.score)
