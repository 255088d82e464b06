"""How well silhouettes overlap the true masks of the street photographs."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimator import Estimator
from app.vision.people import Box, Detection, Silhouette
from app.vision.person.silhouettes import silhouettes_of
from scripts.experiments.asking import found_in
from scripts.experiments.real_data import Photograph


def overlap(mask: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks."""
    return float((mask & truth).sum() / max(1, int((mask | truth).sum())))


def summary(values: Sequence[float], odd: NDArray[np.bool_]) -> dict[str, float]:
    """Mean and median overlap, of all people and of those in odd photographs."""
    every = np.array(values)
    return {
        "people": len(every),
        "mean": float(every.mean()),
        "median": float(np.median(every)),
        "odd_people": int(odd.sum()),
        "odd_mean": float(every[odd].mean()),
        "odd_median": float(np.median(every[odd])),
    }


def odd_people(photographs: Sequence[Photograph]) -> NDArray[np.bool_]:
    """Whether each labelled person is in an odd photograph."""
    return np.concatenate([np.full(len(one.boxes), one.odd) for one in photographs])


def cut_out(
    estimator: Estimator, frame: NDArray[np.uint8], boxes: Sequence[Box]
) -> list[Silhouette | None]:
    """The service's own silhouettes of people in boxes that are given."""
    found = [Detection(box, 1.0) for box in boxes]
    readings = estimator.finder.read(frame, found, lambda: None)
    return silhouettes_of(readings, boxes, frame.shape, exact=True)


def in_true_boxes(photographs: Sequence[Photograph], estimator: Estimator) -> dict[str, float]:
    """Overlap where the true boxes are given; 0 where nobody is made out."""
    values, spent = [], 0.0
    for photograph in tqdm(photographs, desc="true boxes", unit="photograph"):
        started = time.perf_counter()
        silhouettes = cut_out(estimator, photograph.frame, photograph.boxes)
        spent += time.perf_counter() - started
        for label, one in enumerate(silhouettes, start=1):
            truth = photograph.labels == label
            values.append(0.0 if one is None else overlap(one.mask(truth.shape), truth))
    found = summary(values, odd_people(photographs))
    found["milliseconds"] = 1000 * spent / len(values)
    return found


def end_to_end(photographs: Sequence[Photograph], estimator: Estimator) -> dict[str, float]:
    """Overlap of the best silhouette among those of all detections; 0 where none touches."""
    values = []
    for photograph in tqdm(photographs, desc="end to end", unit="photograph"):
        people = found_in(estimator, photograph.frame)
        masks = [one.silhouette.mask(photograph.labels.shape) for one in people if one.silhouette]
        for label in range(1, len(photograph.boxes) + 1):
            truth = photograph.labels == label
            values.append(max((overlap(mask, truth) for mask in masks), default=0.0))
    return summary(values, odd_people(photographs))
