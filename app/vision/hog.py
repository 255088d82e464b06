"""OpenCV's HOG people detector: a linear SVM on histograms of oriented gradients [1]_.

Alone, it searches a pyramid of the frame for upright people. Beside the networks, it scores their
boxes.

References
----------
.. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection", CVPR 2005.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import (
    Box,
    Boxes,
    PixelRect,
    intersections,
    iou_matrix,
    non_max_suppression,
    resize,
)

# The detector was trained on windows of this size, in which a person is 96 px tall and lies within
# these shares of width and height.
_WINDOW_PX = (64, 128)
_PERSON_PX = 96
_PERSON_X = (0.18, 0.82)
_PERSON_Y = (0.09, 0.93)
_STRIDE = (8, 8)
# The score of a box is that of the best window within a stride around it.
_SCORED_PX = (_WINDOW_PX[0] + 2 * _STRIDE[0], _WINDOW_PX[1] + 2 * _STRIDE[1])


def _people_classifier() -> cv2.HOGDescriptor:
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(cv2.HOGDescriptor_getDefaultPeopleDetector())  # type: ignore[attr-defined]
    return hog


# Shared by all threads: `detect` only reads the weights.
_HOG = _people_classifier()


_BOX_SCALE = 1.06  # Windows in which a box is scored, relative to the box.
_MIN_MARGIN = -5.0  # Lower margins are raised to this.


def hog_margin(frame: NDArray[np.uint8], box: Box) -> float:
    """Signed distance from the decision boundary: how much a box looks like a person."""
    scale = _BOX_SCALE * box.height / _PERSON_PX
    width, height = (max(1, round(side * scale)) for side in _SCORED_PX)
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    image = resize(_crop_replicated(frame, (left, top, width, height)), *_SCORED_PX)
    _, margins = _HOG.detect(image, -10.0, _STRIDE, (0, 0))
    return max(_MIN_MARGIN, float(np.max(margins)))


_NMS_IOU = 0.4  # Overlap from which two boxes show one person.


def hog_people(frame: NDArray[np.uint8], min_person_px: float) -> tuple[Boxes, NDArray[np.float64]]:
    """Find upright people of at least this height in a frame ``(H, W, 3)``, BGR.

    Returns
    -------
    boxes : (K, 4) float64 array
        One for each person, in pixels of the frame, best first.
    margins : (K,) float64 array
        Distance from the decision boundary, positive.
    """
    boxes, margins = hog_windows(frame, min_person_px, 0.0)
    if len(boxes) == 0:
        return boxes, margins
    kept = drop_parts(boxes, non_max_suppression(boxes, margins, _NMS_IOU))
    return mean_boxes(boxes, margins, kept), margins[kept]


_PYRAMID_STEP = 1.15  # Coarser than the usual 1.05, at half the time.
# Height of the largest person searched for, as a share of the frame's height.
_MAX_PERSON_SHARE = 1.15
_BORDER_PX = 16  # Padding in the trained window, so that people at the border fill one.


def hog_windows(
    frame: NDArray[np.uint8], min_person_px: float, threshold: float
) -> tuple[Boxes, NDArray[np.float64]]:
    """Find the windows of a pyramid that look like a person, many for each person.

    Returns
    -------
    boxes : (N, 4) float64 array
        Of the person within each window, in pixels of the frame.
    margins : (N,) float64 array
        Signed distance from the decision boundary, at least ``threshold``.
    """
    found = [(np.zeros((0, 4)), np.zeros(0))]
    factor = _PERSON_PX / min_person_px
    while _PERSON_PX / factor <= _MAX_PERSON_SHARE * frame.shape[0]:
        found.append(_search(frame, factor, threshold, _BORDER_PX))
        factor /= _PYRAMID_STEP
    boxes, margins = zip(*found, strict=True)
    return np.vstack(boxes), np.concatenate(margins)


def _search(
    frame: NDArray[np.uint8], factor: float, threshold: float, border_px: int
) -> tuple[Boxes, NDArray[np.float64]]:
    """Search a frame resized by ``factor``."""
    height, width = frame.shape[:2]
    border = int(border_px / factor) + 1
    columns, rows = round((width + 2 * border) * factor), round((height + 2 * border) * factor)
    if columns < _WINDOW_PX[0] or rows < _WINDOW_PX[1]:
        return np.zeros((0, 4)), np.zeros(0)
    padded = _crop_replicated(frame, (-border, -border, width + 2 * border, height + 2 * border))
    corners, margins = _HOG.detect(resize(padded, columns, rows), threshold, _STRIDE, (0, 0))
    if len(corners) == 0:
        return np.zeros((0, 4)), np.zeros(0)
    corner = np.asarray(corners, np.float64).reshape(-1, 2)
    boxes = np.empty((len(corner), 4))
    boxes[:, 0] = (corner[:, 0] + _PERSON_X[0] * _WINDOW_PX[0]) / factor - border - 0.5
    boxes[:, 1] = (corner[:, 1] + _PERSON_Y[0] * _WINDOW_PX[1]) / factor - border - 0.5
    boxes[:, 2] = (_PERSON_X[1] - _PERSON_X[0]) * _WINDOW_PX[0] / factor
    boxes[:, 3] = (_PERSON_Y[1] - _PERSON_Y[0]) * _WINDOW_PX[1] / factor
    return boxes, np.ravel(margins).astype(np.float64)


# Two boxes show a part and the whole of one body if they share this much of the smaller box and
# their axes are no farther apart than this share of the wider box.
_PART_SHARE = 0.8
_PART_DISTANCE = 0.3


def drop_parts(boxes: Boxes, kept: list[int]) -> list[int]:
    """Drop boxes of a head and trunk within a better box of the whole body, and the reverse.

    ``kept`` are rows of ``boxes``, best first. Two people side by side are both kept, since their
    axes differ.
    """
    shared = intersections(boxes, boxes)
    area = boxes[:, 2] * boxes[:, 3]
    axis = boxes[:, 0] + boxes[:, 2] / 2
    result: list[int] = []
    for row in kept:
        is_part = any(
            shared[row, other] > _PART_SHARE * min(area[row], area[other])
            and abs(axis[row] - axis[other]) < _PART_DISTANCE * max(boxes[row, 2], boxes[other, 2])
            for other in result
        )
        if not is_part:
            result.append(row)
    return result


# Overlap with a person's best box above which a box is used in the person's mean box.
_MEAN_IOU = 0.6
_MEAN_MARGIN = 0.1  # Added to the margins that weight this mean, which may be 0.


def mean_boxes(boxes: Boxes, margins: NDArray[np.float64], kept: list[int]) -> Boxes:
    """Mean of the boxes about each kept one ``(len(kept), 4)``, weighted by margin and overlap."""
    overlaps = iou_matrix(boxes[kept], boxes)
    scores = margins + _MEAN_MARGIN
    weights = np.where(overlaps > _MEAN_IOU, overlaps * scores**3, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    corners = weights @ np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])
    return np.hstack([corners[:, :2], corners[:, 2:] - corners[:, :2]])


def _crop_replicated(frame: NDArray[np.uint8], rect: PixelRect) -> NDArray[np.uint8]:
    """Crop a frame, replicating its border, so that no edge is added."""
    left, top, width, height = rect
    rows, columns = frame.shape[:2]
    # A rectangle wholly beyond the frame shows its nearest border.
    x0, x1 = (min(max(x, 0), columns - 1) for x in (left, left + width - 1))
    y0, y1 = (min(max(y, 0), rows - 1) for y in (top, top + height - 1))
    inside = frame[y0 : y1 + 1, x0 : x1 + 1]
    across, down = width - inside.shape[1], height - inside.shape[0]
    before_x, before_y = min(max(0, -left), across), min(max(0, -top), down)
    padded = cv2.copyMakeBorder(
        inside, before_y, down - before_y, before_x, across - before_x, cv2.BORDER_REPLICATE
    )
    return padded.astype(np.uint8, copy=False)
