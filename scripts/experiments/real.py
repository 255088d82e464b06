"""The real experiment: street photographs and videos of ``../shared/real``.

Settings of silhouettes and poses were chosen with a look at even-numbered photographs, so that the
odd ones, always shown beside all, are their test. The detector is fitted to none of them.
The references of poses are MediaPipe's (street people) and a multi-view triangulation
(``pose2sim``): something to compare with, not ground truth.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.photograph import Estimator, load_estimator
from app.settings import Settings
from app.vision.detector import MIN_DETECTION_SCORE, NetworkDetector
from app.vision.geometry import Box, iou_matrix
from index import DEFAULT_PATH
from scripts.datasets import Marks, Photograph, as_array, read_marks, read_pennfudan, read_vtest
from scripts.experiments.real_detection import measure_detection, measure_hog
from scripts.experiments.real_poses import cut_out
from scripts.metrics import FOUND_FROM, mask_iou, true_positives

STEP = 4
"""Every so many-th frame of Pose2Sim is asked: neighbours are alike."""

SCORES = {"default": MIN_DETECTION_SCORE, "sure": 0.5}
"""Minimum detection scores."""

IGNORED_FROM = 0.3
"""Minimum overlap (IoU) of a box with an ignored person at which it counts neither way."""

Figures = dict[str, float]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH, help="index artefact to ask")


def run(options: argparse.Namespace) -> dict[str, object]:
    """Run the experiment."""
    cv2.setNumThreads(1)
    estimator = load_estimator(Settings(index=options.index))
    detector = estimator.models.detector
    folder = options.shared / "real"
    photographs = read_pennfudan(folder / "pennfudan")
    frames = read_vtest(folder / "vtest")
    return {
        "detection": {"hog": measure_hog(photographs), **measure_detection(photographs, detector)},
        "silhouettes": measure_silhouettes(photographs, estimator),
        "vtest": {
            name: measure_vtest(frames, read_marks(), detector, score)
            for name, score in SCORES.items()
        },
    }


def measure_silhouettes(photographs: Sequence[Photograph], estimator: Estimator) -> Figures:
    """Return the overlap with the true masks in true boxes; 0 where none is found."""
    values, spent = [], 0.0
    for photograph in tqdm(photographs, desc="true boxes", unit="photograph"):
        started = time.perf_counter()
        silhouettes = cut_out(estimator, photograph.frame, photograph.boxes)
        spent += time.perf_counter() - started
        for label, one in enumerate(silhouettes, start=1):
            truth = photograph.labels == label
            values.append(0.0 if one is None else mask_iou(one.mask(truth.shape), truth))
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


def measure_vtest(
    frames: Sequence[tuple[int, NDArray[np.uint8]]],
    marks: Sequence[Marks],
    detector: NetworkDetector,
    min_score: float,
) -> Figures:
    """Return the percentage of marked walkers found in numbered frames, and false boxes."""
    by_number = dict(frames)
    marked = found = boxes = false = 0
    spent = []
    for one in marks:
        frame = by_number[one.frame]
        started = time.perf_counter()
        detections = [d for d in detector.detect(frame)[0] if d.score >= min_score]
        spent.append(1000 * (time.perf_counter() - started))
        hits, wrong = compare([d.box for d in detections], one)
        marked += len(one.people)
        found += hits
        boxes += len(detections)
        false += wrong
    return {
        "min_score": min_score,
        "found_from": FOUND_FROM,
        "frames": len(marks),
        "walkers": marked,
        "found": 100 * found / max(1, marked),
        "boxes": boxes,
        "false_per_frame": false / max(1, len(marks)),
        "milliseconds": float(np.median(spent)),
    }


def compare(boxes: Sequence[Box], marks: Marks) -> tuple[int, int]:
    """Count walkers found and false boxes; boxes come best first."""
    places = as_array(boxes)
    right = true_positives((places, -np.arange(float(len(places)))), as_array(marks.people))
    ignored = iou_matrix(places, as_array(marks.ignored)).max(axis=1, initial=0) >= IGNORED_FROM
    return int(right.sum()), int((~right & ~ignored).sum())
