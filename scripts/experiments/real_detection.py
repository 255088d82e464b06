"""People found in street photographs, by the detector as shipped and by parts of it."""

import time
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from app.networks.probabilities import sigmoid
from app.vision.detector import NetworkDetector, detection_odds
from app.vision.detectors.hog import HogDetector
from app.vision.detectors.tiles import Picture
from scripts.datasets import Photograph, as_array
from scripts.metrics import detection_figures

DETECTORS = {
    "both_networks_and_hog": [True, True, True],
    "both_networks": [True, False, True],
    "movenet_alone": [True, False, False],
}
"""Scores of the candidates that count; the others are 0, as of people whom a detector misses."""

Figures = dict[str, float]


def measure_detection(
    photographs: Sequence[Photograph], detector: NetworkDetector
) -> dict[str, Figures]:
    """Return the figures of the detectors, before doubtful people are compared with objects."""
    candidates, spent = [], []
    for photograph in tqdm(photographs, desc="candidates", unit="photograph"):
        started = time.perf_counter()
        found, scores, _ = detector.candidates(photograph.frame)
        spent.append(1000 * (time.perf_counter() - started))
        candidates.append((as_array([one.box for one in found]), scores))
    truths = [as_array(photograph.boxes) for photograph in photographs]
    figures = {}
    for name, counted in DETECTORS.items():
        scored = [
            (boxes, sigmoid(detection_odds(scores * np.array(counted))))
            for boxes, scores in candidates
        ]
        figures[name] = detection_figures(scored, truths)
        figures[name]["milliseconds"] = float(np.median(spent))
    return figures


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
