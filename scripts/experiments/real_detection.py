"""People found in street photographs, by detectors whose weights never saw the photograph."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.vision.detector import HogDetector, NetworkDetector, detection_features
from app.vision.geometry import Boxes
from app.vision.odds import sigmoid
from scripts.experiments.real_data import Photograph, as_array
from scripts.experiments.real_detection_scores import (
    average_precision,
    figures,
    matches,
    recall_at,
    rightness,
)

SPLITS = 3
"""Cross-validations, each with folds of its own; figures are their mean."""

FOLDS = 5


@dataclass(frozen=True)
class Candidates:
    """What a detector takes for people in one photograph, with what speaks for each ``(N, 3)``."""

    boxes: Boxes
    features: NDArray[np.float64]
    milliseconds: float


def all_candidates(
    photographs: Sequence[Photograph], detector: NetworkDetector
) -> list[Candidates]:
    """Candidates of every photograph."""
    result = []
    for photograph in tqdm(photographs, desc="candidates", unit="photograph"):
        started = time.perf_counter()
        found, scores = detector.candidates(photograph.frame)
        spent = 1000 * (time.perf_counter() - started)
        boxes = as_array([one.box for one in found])
        result.append(Candidates(boxes, detection_features(scores), spent))
    return result


def fit_hog(photographs: Sequence[Photograph]) -> dict[str, float]:
    """The constants by which HOG's margins alone become probabilities."""
    right, margins = [], []
    alone = HogDetector(min_score=0.0)
    for photograph in photographs:
        boxes, found = alone.people(photograph.frame)
        right.append(rightness((boxes, found), as_array(photograph.boxes)))
        margins.append(found)
    model = LogisticRegression().fit(np.concatenate(margins)[:, None], np.concatenate(right))
    return {
        "hog_alone": round(float(model.coef_[0, 0]), 4),
        "hog_alone_offset": round(float(model.intercept_[0]), 4),
    }


def measure_detection(
    photographs: Sequence[Photograph], candidates: Sequence[Candidates]
) -> dict[str, dict[str, float]]:
    """Figures of the detectors; what is fitted is cross-validated by photograph."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    found = {
        "both networks and HOG": _cross_validated(candidates, truths, [0, 1, 2]),
        "both networks": _cross_validated(candidates, truths, [0, 2]),
        "MoveNet alone": _cross_validated(candidates, truths, [0]),
    }
    spent = float(np.median([one.milliseconds for one in candidates]))
    for one in found.values():
        one["milliseconds"] = spent
    alone = HogDetector(min_score=0.0)
    by_hog, spent_by_hog = [], []
    for photograph in tqdm(photographs, desc="HOG alone", unit="photograph"):
        started = time.perf_counter()
        people = alone.detect(photograph.frame)
        spent_by_hog.append(1000 * (time.perf_counter() - started))
        scores = np.array([one.score for one in people])
        by_hog.append((as_array([one.box for one in people]), scores))
    found["HOG alone"] = {**figures(by_hog, truths), "milliseconds": float(np.median(spent_by_hog))}
    return found


def _cross_validated(
    candidates: Sequence[Candidates], truths: Sequence[Boxes], columns: list[int]
) -> dict[str, float]:
    splits = []
    for seed in range(SPLITS):
        fold = np.random.default_rng(seed).permutation(len(candidates)) % FOLDS
        scored: list[tuple[Boxes, NDArray[np.float64]]] = [
            (one.boxes, np.zeros(0)) for one in candidates
        ]
        for held in range(FOLDS):
            known = np.flatnonzero(fold != held).tolist()
            model = _fit([candidates[i] for i in known], [truths[i] for i in known], columns)
            for i in np.flatnonzero(fold == held).tolist():
                odds = candidates[i].features[:, columns] @ model.coef_[0] + model.intercept_[0]
                scored[i] = (candidates[i].boxes, sigmoid(odds))
        table = matches(scored, truths)
        people = sum(map(len, truths))
        splits.append(
            {
                **figures(scored, truths),
                "average_precision": average_precision(table, people),
                "recall_at_90": recall_at(table, people, precision=0.9),
            }
        )
    return {key: float(np.mean([split[key] for split in splits])) for key in splits[0]}


def _fit(
    candidates: Sequence[Candidates], truths: Sequence[Boxes], columns: list[int]
) -> LogisticRegression:
    right = [
        rightness((one.boxes, one.features[:, 0]), truth)
        for one, truth in zip(candidates, truths, strict=True)
    ]
    features = np.concatenate([one.features[:, columns] for one in candidates])
    return LogisticRegression().fit(features, np.concatenate(right))
