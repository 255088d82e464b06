"""People found in the street video, against marks made by hand."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.vision.detector import Detector
from app.vision.geometry import Box, iou_matrix
from scripts.experiments.real_data import as_array
from scripts.experiments.real_detection_scores import rightness

ROOT = Path(__file__).resolve().parent.parent.parent
MARKS = ROOT / "tests" / "data" / "vtest-people.json"
IGNORED_FROM = 0.3
"""Overlap (IoU) from which a box is of somebody who counts neither way."""


@dataclass(frozen=True)
class Marks:
    """The people of one numbered frame.

    ``people`` are walkers of whom at least half is seen, 50 px tall or more. Whether the others are
    found counts neither way.
    """

    frame: int
    people: list[Box]
    ignored: list[Box]


def read_marks(file: Path = MARKS) -> list[Marks]:
    """Read the marks of all frames."""
    document = json.loads(file.read_text())
    return [
        Marks(
            int(one["frame"]),
            [Box(*map(float, box)) for box in one["people"]],
            [Box(*map(float, box)) for box in one["ignored"]],
        )
        for one in document["frames"]
    ]


def measure_vtest(
    frames: Sequence[tuple[int, NDArray[np.uint8]]],
    marks: Sequence[Marks],
    detector: Detector,
    min_score: float,
) -> dict[str, float]:
    """Share of the marked walkers that are found in numbered frames, and false boxes per frame."""
    by_number = dict(frames)
    marked = found = boxes = false = 0
    spent = []
    for one in marks:
        frame = by_number[one.frame]
        started = time.perf_counter()
        detections = [d for d in detector.detect(frame) if d.score >= min_score]
        spent.append(1000 * (time.perf_counter() - started))
        hits, wrong = compare([d.box for d in detections], one)
        marked += len(one.people)
        found += hits
        boxes += len(detections)
        false += wrong
    return {
        "frames": len(marks),
        "walkers": marked,
        "found": found / max(1, marked),
        "boxes": boxes,
        "false_per_frame": false / max(1, len(marks)),
        "milliseconds": float(np.median(spent)),
    }


def compare(boxes: Sequence[Box], marks: Marks) -> tuple[int, int]:
    """Count walkers found and false boxes; boxes come best first."""
    places = as_array(boxes)
    right = rightness((places, -np.arange(float(len(places)))), as_array(marks.people))
    ignored = iou_matrix(places, as_array(marks.ignored)).max(axis=1, initial=0) >= IGNORED_FROM
    return int(right.sum()), int((~right & ~ignored).sum())
