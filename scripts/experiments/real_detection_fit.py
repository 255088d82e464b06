"""The detector's few weights, fitted to street photographs and cross-validated on them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.vision import detect as detection
from app.vision.box_arrays import Boxes, iou_matrix
from app.vision.evidence import NAMES
from app.vision.joints import JointReader
from app.vision.networks import PersonNetwork
from app.vision.people import Box
from app.vision.presence import presence_maps
from app.vision.second_look import look_again
from app.vision.segment import NetworkSegmenter
from scripts.experiments.real_data import Photograph, as_array
from scripts.experiments.real_detection_scores import Scored, matches, rightness

MIN_PERSON_PX = 50
FOLDS = 5

LookAgain = Callable[[Photograph, Scored], NDArray[np.float64]]
"""Photograph and detections to how clearly joints show in each; see :func:`look_by`."""


@dataclass(frozen=True)
class Candidates:
    """Candidate boxes of one photograph, their features, their overlap with the truth, the time."""

    boxes: Boxes
    features: NDArray[np.float64]
    overlap: NDArray[np.float64]
    milliseconds: float


def look_by(segmenter: NetworkSegmenter, reader: JointReader) -> LookAgain:
    """How the service looks again: NaN where it does not, minus infinity where nobody shows."""

    def look(photograph: Photograph, found: Scored) -> NDArray[np.float64]:
        boxes = [Box(*box.tolist()) for box in found[0]]
        return look_again(segmenter, reader, photograph.frame, boxes, found[1])

    return look


def all_candidates(photographs: Sequence[Photograph], network: PersonNetwork) -> list[Candidates]:
    """Candidates of every photograph."""
    result = []
    for photograph in tqdm(photographs, desc="candidates", unit="photograph"):
        started = time.perf_counter()
        maps = presence_maps(network, photograph.frame, MIN_PERSON_PX)
        boxes, features = detection.candidates(maps, photograph.frame, MIN_PERSON_PX)
        spent = 1000 * (time.perf_counter() - started)
        overlap = iou_matrix(boxes, as_array(photograph.boxes)).max(axis=1, initial=0)
        result.append(Candidates(boxes, features, overlap, spent))
    return result


def fit_logistic(
    features: NDArray[np.float64], right: NDArray[np.bool_], ridge: float = 3.0
) -> tuple[NDArray[np.float64], float]:
    """Weights and offset of a ridge logistic regression, by Newton's method.

    The ridge acts on standardised features and not on the offset.
    """
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-9
    design = np.hstack([(features - mean) / spread, np.ones((len(features), 1))])
    penalty = np.diag([ridge] * features.shape[1] + [0.0])
    weights = np.zeros(design.shape[1])
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(design @ weights, -30, 30)))
        gradient = design.T @ (p - right) + penalty @ weights
        hessian = design.T @ (design * (p * (1 - p))[:, None]) + penalty
        weights -= np.linalg.solve(hessian, gradient)
    scaled = weights[:-1] / spread
    return scaled, float(weights[-1] - scaled @ mean)


def fitted(people: Sequence[Candidates]) -> tuple[NDArray[np.float64], float]:
    """Weights that tell candidates that are right by a margin from those that are wrong.

    What overlaps by a little over half counts as neither: it would teach to be content with
    a box that the merging can still improve.
    """
    features = np.vstack([one.features for one in people])
    overlap = np.concatenate([one.overlap for one in people])
    clear = (overlap > 0.65) | (overlap < 0.5)
    return fit_logistic(features[clear], overlap[clear] > 0.65)


def merged(one: Candidates, weights: NDArray[np.float64], offset: float) -> Scored:
    """Merge candidates into detections, with log odds for scores."""
    odds = one.features @ weights + offset
    boxes, kept = detection.merge(one.boxes, odds)
    return boxes, odds[kept]


def folds(count: int, seed: int) -> NDArray[np.int64]:
    """Which fold each of so many photographs is in."""
    return np.random.default_rng(seed).permutation(count) % FOLDS


def cross_validated(people: Sequence[Candidates], seed: int) -> list[Scored]:
    """Detect in every photograph by weights fitted without it."""
    fold = folds(len(people), seed)
    found: list[Scored] = [(np.zeros((0, 4)), np.zeros(0))] * len(people)
    for held in range(FOLDS):
        model = fitted([one for one, f in zip(people, fold, strict=True) if f != held])
        for index in np.flatnonzero(fold == held).tolist():
            found[index] = merged(people[index], *model)
    return found


def calibration(found: Sequence[Scored], truths: Sequence[Boxes]) -> tuple[float, float]:
    """Slope and offset that turn log odds of merged detections into probabilities."""
    table = matches(found, truths)
    slope, offset = fit_logistic(table[:, :1], table[:, 1] > 0.5, ridge=0.01)
    return float(slope[0]), offset


def as_probabilities(found: Sequence[Scored], slope: float, offset: float) -> list[Scored]:
    """Apply a calibration to log odds."""
    return [(boxes, 1 / (1 + np.exp(-slope * odds - offset))) for boxes, odds in found]


def fitted_look(
    found: Sequence[Scored], looked: Sequence[NDArray[np.float64]], truths: Sequence[Boxes]
) -> tuple[NDArray[np.float64], float]:
    """Weights of score and clarity, and the offset, that tell whom the detector doubts."""
    features, right = [], []
    for one, clarity, truth in zip(found, looked, truths, strict=True):
        doubted = np.isfinite(clarity)
        features.append(np.stack([detection.log_odds(one[1][doubted]), clarity[doubted]], axis=1))
        right.append(rightness(one, truth)[doubted])
    return fit_logistic(np.concatenate(features), np.concatenate(right), ridge=0.1)


def looked_again(
    found: Sequence[Scored],
    looked: Sequence[NDArray[np.float64]],
    truths: Sequence[Boxes],
    seed: int,
) -> list[Scored]:
    """Replace scores that are doubted by what weights say that were fitted without the photograph.

    Parameters
    ----------
    found : sequence of (boxes, scores)
        One for each photograph.
    looked : sequence of (N,) float64 arrays
        How clearly joints show; NaN where nobody looked, minus infinity where nobody was seen.
    truths : sequence of (P, 4) float64 arrays
    seed : int
        Of the folds.
    """
    fold = folds(len(found), seed)
    result = list(found)
    for held in range(FOLDS):
        others = np.flatnonzero(fold != held).tolist()
        weights, offset = fitted_look(
            [found[i] for i in others], [looked[i] for i in others], [truths[i] for i in others]
        )
        for index in np.flatnonzero(fold == held).tolist():
            (boxes, scores), clarity = found[index], looked[index]
            doubted = ~np.isnan(clarity)
            features = np.stack([detection.log_odds(scores[doubted]), clarity[doubted]], axis=1)
            again = scores.copy()
            again[doubted] = detection.probability(features @ weights + offset)
            result[index] = boxes, again
    return result


def fit_detector(photographs: Sequence[Photograph], network: PersonNetwork, look: LookAgain) -> str:
    """What ``app/vision/detect.py`` and ``second_look.py`` hold, fitted to all photographs."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    people = all_candidates(photographs, network)
    weights, offset = fitted(people)
    slopes, looks = [], []
    for seed in range(5):
        odds = cross_validated(people, seed)
        slopes.append(calibration(odds, truths))
        found = as_probabilities(odds, *slopes[-1])
        looked = [look(*one) for one in zip(photographs, found, strict=True)]
        weighed, look_offset = fitted_look(found, looked, truths)
        looks.append((*weighed, look_offset))
    slope, shift = np.mean(slopes, axis=0)
    alone = [detection.gradient_detections(one.frame, MIN_PERSON_PX) for one in photographs]
    hog_slope, hog_shift = calibration(alone, truths)
    rows = [f"        {weight:.3f},  # {name}" for name, weight in zip(NAMES, weights, strict=True)]
    return "\n".join(
        [
            "_WEIGHTS = np.array(",
            "    [",
            *rows,
            "    ]",
            ")",
            f"_OFFSET = {offset:.3f}",
            f"_CALIBRATION_SLOPE, _CALIBRATION_OFFSET = {slope:.3f}, {shift:.3f}",
            f"_HOG_SLOPE, _HOG_OFFSET = {hog_slope:.3f}, {hog_shift:.3f}",
            "",
            "_ODDS, _CLARITY, _OFFSET = {:.2f}, {:.2f}, {:.2f}".format(*np.mean(looks, axis=0)),
        ]
    )
