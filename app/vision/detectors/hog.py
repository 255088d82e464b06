"""OpenCV's people detector: a linear SVM on histograms of oriented gradients (HOG) [1]_.

It recognises upright people. :class:`HogDetector` searches a whole frame over many scales, as in
the paper; :func:`hog_margin` scores a box that another detector has found.

References
----------
.. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection", CVPR 2005.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import sigmoid
from app.vision.detectors.tiles import MAX_FINE_PX, Picture
from app.vision.geometry import Box, Boxes, iou_matrix, resize
from app.vision.halved import whole
from app.vision.people import Detection

PERSON_PX = 96
"""Height of a person in the windows on which the detector was trained."""

_WINDOW_PX = (64, 128)
_STRIDE_PX = 8


# Shared by all threads: detection only reads the weights.
_HOG = cv2.HOGDescriptor()
_HOG.setSVMDetector(cv2.HOGDescriptor_getDefaultPeopleDetector())  # type: ignore[attr-defined]


@dataclass(frozen=True)
class HogDetector:
    """Detects upright people by HOG over many scales; thread-safe.

    ``min_person_px`` is the height of the smallest person searched for, pixels; by default a share
    of the frame's. Frames are not enlarged beyond a bounded area, so it may not be reached.
    """

    min_person_px: float | None = None

    def detect(self, picture: Picture) -> list[Detection]:
        boxes, margins = self.kept_windows(whole(picture.frame))
        # Fitted by `python -m scripts fit-paper` to 134 windows in frames of vtest.
        scores = sigmoid(3.26 * margins - 2.57)
        height, width = picture.frame.shape[:2]
        found = []
        for row, score in zip(boxes.tolist(), scores.tolist(), strict=True):
            box = Box(*row).clip(width, height)
            if box is not None:
                found.append(Detection(box, score))
        return found

    def kept_windows(self, frame: NDArray[np.uint8]) -> tuple[Boxes, NDArray[np.float64]]:
        """The windows that are left after non-maximum suppression, as :meth:`windows`."""
        boxes, margins = self.windows(frame)
        kept = _without_overlaps(boxes, margins)
        return boxes[kept], margins[kept]

    def windows(self, frame: NDArray[np.uint8]) -> tuple[Boxes, NDArray[np.float64]]:
        """Boxes ``(N, 4)`` of all windows of a frame with a positive margin, and their margins."""
        height, width = frame.shape[:2]
        # Smaller people take most of the time, and hardly any more are found (vtest: 91 instead of
        # 92 %).
        smallest = self.min_person_px or height / 8
        factor = min(PERSON_PX / smallest, math.sqrt(MAX_FINE_PX / (height * width)))
        size = max(1, round(factor * width)), max(1, round(factor * height))
        # OpenCV crashes on an image that holds no window.
        right, below = (max(0, least - side) for least, side in zip(_WINDOW_PX, size, strict=True))
        image = cv2.copyMakeBorder(
            resize(frame, *size), 0, below, 0, right, cv2.BORDER_REPLICATE
        ).astype(np.uint8, copy=False)
        # Factor between scales. With 1.1, a search takes half the time and misses large people.
        rects, weights = _HOG.detectMultiScale(
            image,
            winStride=(_STRIDE_PX, _STRIDE_PX),
            padding=(2 * _STRIDE_PX, 2 * _STRIDE_PX),
            scale=1.05,
            groupThreshold=0,
        )
        found = np.asarray(rects, np.float64).reshape(-1, 4)
        margins = np.asarray(weights, np.float64).ravel()
        # OpenCV's threads add windows in any order.
        # Windows that are compared with one another, which bounds the memory.
        order = np.lexsort((*found.T, -margins))[:1000]
        found, margins = found[order], margins[order]
        # The person in a window, as shares of it: left, top, width, height. Chosen on vtest.
        sides = np.tile(found[:, 2:], 2) * np.array([0.22, 0.1, 0.56, 0.8])
        sides[:, :2] += found[:, :2]
        boxes = sides / np.tile([size[0] / width, size[1] / height], 2)
        boxes[:, :2] -= 0.5
        return boxes, margins


def _without_overlaps(boxes: Boxes, margins: NDArray[np.float64]) -> list[int]:
    """Non-maximum suppression: rows of the windows that are kept, the largest margin first."""
    low = np.maximum(boxes[:, None, :2], boxes[None, :, :2])
    ends = boxes[:, :2] + boxes[:, 2:]
    shared = np.clip(np.minimum(ends[:, None], ends[None]) - low, 0, None).prod(axis=2)
    areas = boxes[:, 2:].prod(axis=1)
    covered = shared / np.minimum(areas[:, None], areas[None])
    # Windows on the legs of a person, for example, are covered by another one.
    clash = (iou_matrix(boxes, boxes) >= 0.4) | (covered >= 0.7)
    kept: list[int] = []
    for row in np.argsort(-margins, kind="stable").tolist():
        if not clash[row, kept].any():
            kept.append(row)
    return kept


# The score of a box is that of the best window within a stride around it.
_SCORED_PX = tuple(side + 2 * _STRIDE_PX for side in _WINDOW_PX)


def hog_margin(frame: NDArray[np.uint8], box: Box) -> float:
    """Signed distance from the decision boundary: how much a box looks like a person."""
    # Windows in which a box is scored, relative to the box.
    scale = 1.06 * box.height / PERSON_PX
    width, height = (max(1, round(side * scale)) for side in _SCORED_PX)
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    # At whole pixels; the frame's border is repeated beyond the frame, so that no edge is added.
    around = cv2.getRectSubPix(
        frame, (width, height), (left + (width - 1) / 2, top + (height - 1) / 2)
    ).astype(np.uint8, copy=False)
    _, margins = _HOG.detect(resize(around, *_SCORED_PX), -10.0, (_STRIDE_PX, _STRIDE_PX), (0, 0))
    # Lower margins are raised to this.
    return max(-5.0, float(np.max(margins)))
