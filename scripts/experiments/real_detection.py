"""People found in street photographs by the detector and by parts of it, cross-validated."""

import time
from collections.abc import Sequence

import numpy as np
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.vision.detector import NetworkDetector, detection_features
from app.vision.detectors.hog import HogDetector
from app.vision.detectors.tiles import Picture
from app.vision.geometry import Boxes
from app.vision.odds import sigmoid
from scripts.datasets import Photograph, as_array
from scripts.metrics import Scored, detection_figures, true_positives

SPLITS = 3
"""Cross-validations, each with its own folds; figures are their mean."""

FOLDS = 5
DETECTORS = {"both_networks_and_hog": [0, 1, 2], "both_networks": [0, 2], "movenet_alone": [0]}
"""Columns of the features that each detector uses."""

Figures = dict[str, float]


def measure_detection(
    photographs: Sequence[Photograph], detector: NetworkDetector
) -> dict[str, Figures]:
    """Return the figures of the detectors; what is fitted is cross-validated by photograph."""
    candidates, spent = [], []
    for photograph in tqdm(photographs, desc="candidates", unit="photograph"):
        started = time.perf_counter()
        found, scores, _ = detector.candidates(photograph.frame)
        spent.append(1000 * (time.perf_counter() - started))
        candidates.append((as_array([one.box for one in found]), detection_features(scores)))
    truths = [as_array(photograph.boxes) for photograph in photographs]
    milliseconds = float(np.median(spent))
    return {
        name: {**_cross_validated(candidates, truths, columns), "milliseconds": milliseconds}
        for name, columns in DETECTORS.items()
    }


def measure_hog(photographs: Sequence[Photograph]) -> Figures:
    """Return the figures of HOG alone, over many scales; fitted to another scene."""
    found, spent = [], []
    for photograph in tqdm(photographs, desc="HOG", unit="photograph"):
        started = time.perf_counter()
        people = HogDetector().detect(Picture(photograph.frame, ()))
        spent.append(1000 * (time.perf_counter() - started))
        found.append((as_array([one.box for one in people]), np.array([p.score for p in people])))
    truths = [as_array(photograph.boxes) for photograph in photographs]
    return {**detection_figures(found, truths), "milliseconds": float(np.median(spent))}


def _cross_validated(
    candidates: Sequence[Scored], truths: Sequence[Boxes], columns: list[int]
) -> Figures:
    splits = []
    for seed in range(SPLITS):
        fold = np.random.default_rng(seed).permutation(len(candidates)) % FOLDS
        scored = [(boxes, np.zeros(0)) for boxes, _ in candidates]
        for held in range(FOLDS):
            known = np.flatnonzero(fold != held).tolist()
            model = _fit([candidates[i] for i in known], [truths[i] for i in known], columns)
            for i in np.flatnonzero(fold == held).tolist():
                boxes, features = candidates[i]
                odds = features[:, columns] @ model.coef_[0] + model.intercept_[0]
                scored[i] = (boxes, sigmoid(odds))
        splits.append(detection_figures(scored, truths))
    return {key: float(np.mean([split[key] for split in splits])) for key in splits[0]}


def _fit(
    candidates: Sequence[Scored], truths: Sequence[Boxes], columns: list[int]
) -> LogisticRegression:
    right = [
        true_positives((boxes, features[:, 0]), truth)
        for (boxes, features), truth in zip(candidates, truths, strict=True)
    ]
    features = np.concatenate([features[:, columns] for _, features in candidates])
    return LogisticRegression().fit(features, np.concatenate(right))
