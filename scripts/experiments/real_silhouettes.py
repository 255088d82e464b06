"""How well silhouettes overlap the true masks of the street photographs."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimator import Estimator
from app.scheduling.job import Job
from app.vision.geometry import Box
from app.vision.people import Detection, Silhouette
from app.vision.silhouettes import silhouettes_of
from scripts.experiments.real_data import Photograph


def overlap(mask: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks."""
    return float((mask & truth).sum() / max(1, int((mask | truth).sum())))


def cut_out(
    estimator: Estimator, frame: NDArray[np.uint8], boxes: Sequence[Box]
) -> list[Silhouette | None]:
    """The service's own silhouettes of people in boxes that are given."""
    found = [Detection(box, 1.0) for box in boxes]
    readings = estimator.finder.read(frame, found, Job())
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
    odd = np.concatenate([np.full(len(one.boxes), one.odd) for one in photographs])
    every = np.array(values)
    return {
        "people": len(every),
        "mean": float(every.mean()),
        "median": float(np.median(every)),
        "odd_mean": float(every[odd].mean()),
        "odd_median": float(np.median(every[odd])),
        "milliseconds": 1000 * spent / len(values),
    }
