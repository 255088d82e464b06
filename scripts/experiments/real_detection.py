"""People found in street photographs, upright and turned by a quarter.

Detectors are cross-validated by photograph. In the turned photographs light and shadow come from a
side, and the ground stands upright; what is measured is whether lying bodies are found, and the
right way up.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.estimation.results import ObservedPerson
from app.photograph import Estimator
from app.vision.detector import NetworkDetector, detection_features
from app.vision.geometry import Boxes
from app.vision.odds import sigmoid
from index.skeleton import wrap_degrees
from scripts.datasets import Photograph, as_array, rotate_box
from scripts.experiments.real_poses import mask_iou
from scripts.helpers import estimate, find_people
from scripts.metrics import (
    average_precision,
    detection_figures,
    matches,
    recall_at,
    rightness,
)

SPLITS = 3
"""Cross-validations, each with its own folds; figures are their mean."""

FOLDS = 5
UPRIGHT = ("standing", "walking")
DETECTORS = {
    "both_networks_and_hog": [0, 1, 2],
    "both_networks": [0, 2],
    "movenet_alone": [0],
}
"""Columns of the features that each detector uses."""

Figures = dict[str, float]


@dataclass(frozen=True)
class Candidates:
    """What a detector takes for people in one photograph, with features ``(N, 3)`` of each."""

    boxes: Boxes
    features: NDArray[np.float64]
    milliseconds: float


def all_candidates(
    photographs: Sequence[Photograph], detector: NetworkDetector
) -> list[Candidates]:
    """Return the candidates of every photograph."""
    result = []
    for photograph in tqdm(photographs, desc="candidates", unit="photograph"):
        started = time.perf_counter()
        found, scores = detector.candidates(photograph.frame)
        spent = 1000 * (time.perf_counter() - started)
        boxes = as_array([one.box for one in found])
        result.append(Candidates(boxes, detection_features(scores), spent))
    return result


def measure_detection(
    photographs: Sequence[Photograph], candidates: Sequence[Candidates]
) -> dict[str, Figures]:
    """Return the figures of the detectors; what is fitted is cross-validated by photograph."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    spent = float(np.median([one.milliseconds for one in candidates]))
    return {
        name: {**_cross_validated(candidates, truths, columns), "milliseconds": spent}
        for name, columns in DETECTORS.items()
    }


def _cross_validated(
    candidates: Sequence[Candidates], truths: Sequence[Boxes], columns: list[int]
) -> Figures:
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
        table, people = matches(scored, truths), sum(map(len, truths))
        splits.append({
            **detection_figures(scored, truths),
            "average_precision": average_precision(table, people),
            "recall_at_90": recall_at(table, people, precision=0.9),
        })  # fmt: skip
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


@dataclass
class LyingCounts:
    """Counts over the turned photographs, and over the same photographs as they are."""

    people: int = 0
    detections: int = 0
    found: int = 0
    found_right_way_up: int = 0
    boxes_right_way_up: int = 0
    upright_detections: int = 0
    upright_taken_for_lying: int = 0


def measure_lying(photographs: Sequence[Photograph], estimator: Estimator) -> Figures:
    """Return the percentage of lying people who are found, and of these the right way up.

    The odd photographs are turned to the left, the others to the right.
    """
    counts = LyingCounts()
    overlaps: list[float] = []
    lies: list[bool] = []
    stands: list[bool] = []
    for photograph in tqdm(photographs, desc="lying", unit="photograph"):
        turns = 1 if photograph.odd else 3
        roll_deg = -90.0 * turns
        frame = np.ascontiguousarray(np.rot90(photograph.frame, turns))
        labels = np.rot90(photograph.labels, turns)
        boxes = [rotate_box(box, photograph.frame.shape, turns) for box in photograph.boxes]
        _count_found(counts, find_people(estimator, frame), as_array(boxes), roll_deg)
        answers = estimate(estimator, frame, *boxes)
        lies += [person.posture.label == "lying" for person in answers if person.posture]
        as_taken = estimate(estimator, photograph.frame, *photograph.boxes)
        stands += [person.posture.label in UPRIGHT for person in as_taken if person.posture]
        by_box = {person.observed.box: person.observed for person in answers}
        for label, box in enumerate(boxes, start=1):
            person = by_box.get(box)
            if person is None or person.silhouette is None:
                overlaps.append(0.0)
                continue
            counts.boxes_right_way_up += is_turned(person, roll_deg)
            truth = labels == label
            overlaps.append(mask_iou(person.silhouette.mask(truth.shape), truth))
        for detection in find_people(estimator, photograph.frame):
            counts.upright_detections += 1
            counts.upright_taken_for_lying += not is_turned(detection, 0.0)
    upright = max(1, counts.upright_detections)
    return {
        "photographs": len(photographs),
        "people": counts.people,
        "found": 100 * counts.found / counts.people,
        "precision": 100 * counts.found / max(1, counts.detections),
        "right_way_up": 100 * counts.found_right_way_up / max(1, counts.found),
        "by_box": 100 * counts.boxes_right_way_up / counts.people,
        "posture_lying": 100 * float(np.mean(lies)),
        "posture_upright": 100 * float(np.mean(stands)),
        "overlap_mean": float(np.mean(overlaps)),
        "overlap_median": float(np.median(overlaps)),
        "upright_taken_for_lying": 100 * counts.upright_taken_for_lying / upright,
    }


def _count_found(
    counts: LyingCounts, detections: Sequence[ObservedPerson], truth: Boxes, roll_deg: float
) -> None:
    boxes = as_array([detection.box for detection in detections])
    right = rightness((boxes, -np.arange(float(len(boxes)))), truth).tolist()
    counts.people += len(truth)
    counts.detections += len(detections)
    counts.found += sum(right)
    counts.found_right_way_up += sum(
        is_turned(detection, roll_deg)
        for detection, one in zip(detections, right, strict=True)
        if one
    )


def is_turned(person: ObservedPerson, roll_deg: float) -> bool:
    """Return whether the head is found in a direction, to 45 degrees."""
    window = person.next_window
    return window is not None and bool(abs(wrap_degrees(window.roll_deg - roll_deg)) < 45)
