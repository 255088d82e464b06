"""Accuracy and time of MoveNet over the size at which it is shown a frame; nothing is fitted.

Penn-Fudan's people are large, those of the street video small; frames are shown whole at several
lengths of the longer side. People are ranked by the network's own score.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.vision.boxes import Boxes, suppress
from app.vision.detection.detector import SAME_PERSON
from app.vision.keypoints.movenet import MoveNet
from app.vision.people import Box
from app.vision.resampling import resize
from app.vision.weights import network_path
from scripts.experiments.real_data import as_array, read_pennfudan, read_vtest
from scripts.experiments.real_detection_scores import Scored, figures, matches, recall_at
from scripts.experiments.real_vtest import Marks, compare, read_marks
from scripts.results import machine

COMMAND = "python -m scripts.evaluate scales"
STREET_PX = (192, 256, 320, 384, 448, 512)
VIDEO_PX = (320, 384, 512, 640, 768)
COMBINED_PX = ((192, 320), (256, 384), (320, 512), (192, 320, 512))
FALSE_PER_FRAME = 0.1


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add nothing: there is nothing to choose."""


def run(options: argparse.Namespace) -> None:
    """Show photographs and video frames at several sizes, and write a table."""
    cv2.setNumThreads(1)
    network = MoveNet(network_path("movenet"), threads=1)
    folder = options.shared / "real"
    photographs = read_pennfudan(folder / "pennfudan")
    truths = [as_array(photograph.boxes) for photograph in photographs]
    street = {
        side: [detect(network, p.frame, side) for p in tqdm(photographs, desc=f"street {side}")]
        for side in STREET_PX
    }
    lines = [
        "# At which size a frame is shown to the network\n",
        f"`{COMMAND}` on {machine()}, one thread; MoveNet alone, ranked by its own score, nothing "
        "fitted, no HOG. Milliseconds of processor time. Several sizes together: people found at "
        "any of them, after non-maximum suppression.\n",
        "## Penn-Fudan, 160 people, 20 to 370 px tall\n",
        "| longer side (px) | AP | recall at a precision of 0.9 | highest recall | ms |",
        "|---|---|---|---|---|",
    ]
    for sides in [*((side,) for side in STREET_PX), *COMBINED_PX]:
        found = [merged([street[side][i][0] for side in sides]) for i in range(len(photographs))]
        spent = sum(float(np.median([ms for _, ms in street[side]])) for side in sides)
        score, table = figures(found, truths), matches(found, truths)
        recall = recall_at(table, int(score["people"]), precision=0.9)
        lines.append(
            f"| {' and '.join(map(str, sides))} | {score['average_precision']:.3f} | {recall:.3f} "
            f"| {score['highest_recall']:.3f} | {spent:.0f} |"
        )
    marks = read_marks()
    frames = dict(read_vtest(folder / "vtest", len(marks)))
    lines += [
        "\n## Street video, 768x576, 110 walkers, 51 to 152 px tall\n",
        f"| longer side (px) | walkers found at {FALSE_PER_FRAME:g} false boxes a frame "
        "| highest recall | ms |",
        "|---|---|---|---|",
    ]
    for side in VIDEO_PX:
        detected = [
            detect(network, frames[mark.frame], side) for mark in tqdm(marks, desc=f"video {side}")
        ]
        found = [merged([scored]) for scored, _ in detected]
        best, highest = video_recall(found, marks)
        spent = float(np.median([ms for _, ms in detected]))
        lines.append(f"| {side} | {100 * best:.1f} % | {100 * highest:.1f} % | {spent:.0f} |")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "scales.md").write_text("\n".join(lines) + "\n")


def detect(network: MoveNet, frame: NDArray[np.uint8], side: int) -> tuple[Scored, float]:
    """People of a frame shown at a length of its longer side, and the processor time in ms."""
    height, width = frame.shape[:2]
    factor = side / max(height, width)
    started = time.thread_time()
    picture = resize(frame, max(1, round(width * factor)), max(1, round(height * factor)))
    people = network.people(picture)
    spent = 1000 * (time.thread_time() - started)
    boxes = as_array([person.box.scaled(1 / factor) for person in people])
    return (boxes, np.array([person.score for person in people], np.float64)), spent


def merged(found: Sequence[Scored]) -> Scored:
    """Merge the detections at several sizes, each person once."""
    boxes: Boxes = np.concatenate([boxes for boxes, _ in found])
    scores = np.concatenate([scores for _, scores in found])
    kept = suppress(boxes, scores, SAME_PERSON)
    return boxes[kept], scores[kept]


def video_recall(found: Sequence[Scored], marks: Sequence[Marks]) -> tuple[float, float]:
    """Share of the walkers found at :data:`FALSE_PER_FRAME`, and at any score."""
    people = sum(len(mark.people) for mark in marks)
    best = highest = 0.0
    for threshold in np.unique(np.concatenate([scores for _, scores in found])):
        counts = [
            compare([Box(*box) for box in boxes[scores >= threshold].tolist()], mark)
            for (boxes, scores), mark in zip(found, marks, strict=True)
        ]
        recall = sum(hits for hits, _ in counts) / people
        highest = max(highest, recall)
        if sum(wrong for _, wrong in counts) <= FALSE_PER_FRAME * len(marks):
            best = max(best, recall)
    return best, highest
