"""People found in street photographs; fitting the detector's few weights, and cross-validation.

Average precision counts every detection that overlaps no *labelled* person by half as wrong.
Penn-Fudan leaves some visible people unlabelled, so the figures are on the low side.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.vision import detect as detection
from app.vision.box_arrays import Boxes, iou_matrix
from app.vision.evidence import NAMES
from app.vision.network import PersonNetwork
from scripts.experiments.real_data import Photograph, as_array

MIN_PERSON_PX = 50
FOLDS = 5
SPLITS = 3
"""Cross-validations, each with folds of its own; figures are their mean."""

Scored = tuple[Boxes, NDArray[np.float64]]


@dataclass(frozen=True)
class Candidates:
    """Candidate boxes of one photograph, their features, their overlap with the truth, the time."""

    boxes: Boxes
    features: NDArray[np.float64]
    overlap: NDArray[np.float64]
    milliseconds: float


def measure_detection(
    photographs: Sequence[Photograph], network: PersonNetwork
) -> dict[str, dict[str, float]]:
    """Figures of both detectors; those of the cascade are cross-validated by photograph."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    people = all_candidates(photographs, network)
    splits = []
    for seed in range(SPLITS):
        odds = cross_validated(people, seed)
        splits.append(figures(as_probabilities(odds, *calibration(odds, truths)), truths))
    cascade = {key: float(np.mean([split[key] for split in splits])) for key in splits[0]}
    best = [
        iou_matrix(one.boxes, truth).max(axis=0, initial=0)
        for one, truth in zip(people, truths, strict=True)
    ]
    cascade["reachable"] = float((np.concatenate(best) >= 0.5).mean())
    # What follows the candidates, their merging, takes less than a millisecond.
    cascade["milliseconds"] = float(np.median([one.milliseconds for one in people]))
    alone = detection.HogDetector(min_score=0.0)
    found, spent = [], []
    for photograph in tqdm(photographs, desc="gradients", unit="photograph"):
        started = time.perf_counter()
        people_found = alone.detect(photograph.frame)
        spent.append(1000 * (time.perf_counter() - started))
        scores = np.array([one.score for one in people_found])
        found.append((as_array([one.box for one in people_found]), scores))
    gradients = figures(found, truths)
    gradients["milliseconds"] = float(np.median(spent))
    return {"cascade": cascade, "gradients": gradients}


def figures(found: Sequence[Scored], truths: Sequence[Boxes]) -> dict[str, float]:
    """Average precision, and recall and precision at a score of 0.5."""
    people = sum(map(len, truths))
    table = matches(found, truths)
    sure = table[table[:, 0] >= 0.5]
    return {
        "people": people,
        "average_precision": average_precision(table, people),
        "recall": float(sure[:, 1].sum() / people),
        "precision": float(sure[:, 1].mean()) if len(sure) else 0.0,
        "highest_recall": float(table[:, 1].sum() / people),
    }


def matches(found: Sequence[Scored], truths: Sequence[Boxes]) -> NDArray[np.float64]:
    """Score and rightness of every detection, best first, ``(N, 2)``.

    A detection is right if it overlaps a labelled person that no better one took by half.
    """
    rows = []
    for (boxes, scores), truth in zip(found, truths, strict=True):
        free = np.ones(len(truth), bool)
        overlaps = iou_matrix(boxes, truth) if len(truth) else np.zeros((len(boxes), 0))
        for index in np.argsort(-scores):
            reachable = np.where(free, overlaps[index], 0)
            right = bool(reachable.size) and reachable.max() >= 0.5
            if right:
                free[reachable.argmax()] = False
            rows.append((scores[index], float(right)))
    table = np.array(rows, np.float64).reshape(-1, 2)
    return table[np.argsort(-table[:, 0], kind="stable")]


def average_precision(table: NDArray[np.float64], people: int) -> float:
    """Area under the precision-recall curve (all points, monotone envelope)."""
    hits = np.cumsum(table[:, 1])
    precision = hits / np.arange(1, len(table) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(np.concatenate([[0], hits / people])) * envelope).sum())


def all_candidates(photographs: Sequence[Photograph], network: PersonNetwork) -> list[Candidates]:
    """Candidates of every photograph."""
    result = []
    for photograph in tqdm(photographs, desc="candidates", unit="photograph"):
        started = time.perf_counter()
        boxes, features = detection.candidates(network, photograph.frame, MIN_PERSON_PX)
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


def cross_validated(people: Sequence[Candidates], seed: int) -> list[Scored]:
    """Detect in every photograph by weights fitted without it."""
    fold = np.random.default_rng(seed).permutation(len(people)) % FOLDS
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


def fit_detector(photographs: Sequence[Photograph], network: PersonNetwork) -> str:
    """What belongs into ``app/vision/detect.py``, fitted to all photographs."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    people = all_candidates(photographs, network)
    weights, offset = fitted(people)
    slopes = [calibration(cross_validated(people, seed), truths) for seed in range(5)]
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
        ]
    )
