"""People found in street photographs, by detectors whose weights never saw the photograph."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from app.vision.box_arrays import iou_matrix
from app.vision.detect import HogDetector
from app.vision.networks import PersonNetwork
from scripts.experiments.real_data import Photograph, as_array
from scripts.experiments.real_detection_fit import (
    LookAgain,
    all_candidates,
    as_probabilities,
    calibration,
    cross_validated,
    looked_again,
)
from scripts.experiments.real_detection_scores import figures

SPLITS = 3
"""Cross-validations, each with folds of its own; figures are their mean."""


def measure_detection(
    photographs: Sequence[Photograph], network: PersonNetwork, look: LookAgain
) -> dict[str, dict[str, float]]:
    """Figures of the detectors; those with fitted weights are cross-validated by photograph."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    people = all_candidates(photographs, network)
    splits, again, spent_again = [], [], []
    for seed in range(SPLITS):
        odds = cross_validated(people, seed)
        found = as_probabilities(odds, *calibration(odds, truths))
        splits.append(figures(found, truths))
        started = time.perf_counter()
        looked = [look(*one) for one in zip(photographs, found, strict=True)]
        spent_again.append(1000 * (time.perf_counter() - started) / len(photographs))
        again.append(figures(looked_again(found, looked, truths, seed), truths))
    cascade, second = (
        {key: float(np.mean([split[key] for split in some])) for key in some[0]}
        for some in (splits, again)
    )
    best = [
        iou_matrix(one.boxes, truth).max(axis=0, initial=0)
        for one, truth in zip(people, truths, strict=True)
    ]
    cascade["reachable"] = float((np.concatenate(best) >= 0.5).mean())
    # What follows the candidates, their merging, takes less than a millisecond.
    cascade["milliseconds"] = float(np.median([one.milliseconds for one in people]))
    second["reachable"] = cascade["reachable"]
    second["milliseconds"] = cascade["milliseconds"] + float(np.mean(spent_again))
    alone = HogDetector(min_score=0.0)
    found, spent = [], []
    for photograph in tqdm(photographs, desc="gradients", unit="photograph"):
        started = time.perf_counter()
        people_found = alone.detect(photograph.frame)
        spent.append(1000 * (time.perf_counter() - started))
        scores = np.array([one.score for one in people_found])
        found.append((as_array([one.box for one in people_found]), scores))
    gradients = figures(found, truths)
    gradients["milliseconds"] = float(np.median(spent))
    return {"cascade, second look": second, "cascade": cascade, "gradients": gradients}
