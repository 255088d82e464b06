"""Small people, with and without the tiles of ``POSE_MIN_PERSON_PX``; the figures are printed.

Photographs and street frames stand at a third of their size in frames of 1920x1080.
"""

import argparse
import time
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.photograph import load_models
from app.vision.geometry import Box
from scripts.datasets import as_array, read_marks, read_pennfudan, read_vtest
from scripts.metrics import detection_figures

Scene = tuple[NDArray[np.uint8], list[Box]]
_SIZE, _GRID = (1080, 1920), (3, 4)
_SHRUNK = 3


def run(options: argparse.Namespace) -> None:
    """Print what is found of both sources."""
    real = options.shared / "real"
    photographs = [(one.frame, one.boxes) for one in read_pennfudan(real / "pennfudan")]
    frames = dict(read_vtest(real / "vtest", len(read_marks())))
    marked = [(frames[one.frame], one.people) for one in read_marks() if not one.ignored]
    detector = load_models(1).detector
    for min_person_px in (None, 30.0):
        for name, pictures in (("photographs", photographs), ("street", marked)):
            found, truths, started = [], [], time.process_time()
            for frame, boxes in scenes(pictures):
                people = detector.detect(frame, min_person_px=min_person_px)[0]
                scores = np.array([one.score for one in people])
                found.append((as_array([one.box for one in people]), scores))
                truths.append(as_array(boxes))
            figures = detection_figures(found, truths)
            figures["core_ms"] = 1000 * (time.process_time() - started) / len(found)
            print(name, min_person_px, {key: round(value, 3) for key, value in figures.items()})


def scenes(pictures: Sequence[Scene]) -> Iterator[Scene]:
    """Grey frames with a grid of pictures at a third of their size, and all their people."""
    rows, columns = _GRID
    for first in range(0, len(pictures), rows * columns):
        frame, people = np.full((*_SIZE, 3), 128, np.uint8), list[Box]()
        for place, (picture, boxes) in enumerate(pictures[first : first + rows * columns]):
            size = picture.shape[1] // _SHRUNK, picture.shape[0] // _SHRUNK
            small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            top, left = place // columns * _SIZE[0] // rows, place % columns * _SIZE[1] // columns
            frame[top : top + size[1], left : left + size[0]] = small
            for box in (box.scaled(1 / _SHRUNK) for box in boxes):
                people.append(Box(box.x + left, box.y + top, box.width, box.height))
        yield frame, people
