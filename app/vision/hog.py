"""OpenCV's HOG people detector, a linear SVM on histograms of oriented gradients.

The detector looks at 64x128 windows in which a person is 96 px tall [1]_. Alone it searches a
pyramid of the frame; beside the network it judges a box on its window alone.

References
----------
.. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection", CVPR 2005.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.boxes import Boxes
from app.vision.geometry import Box
from app.vision.windows import Window, resize

_PERSON_PX = 96
_WINDOW = (64, 128)
_STRIDE = (8, 8)
# Coarser than the usual 1.05: half the time.
_PYRAMID_STEP = 1.15
# The person inside a window, as shares of its width and height.
_PERSON_X = (0.18, 0.82)
_PERSON_Y = (0.09, 0.93)
# Padding about the frame, in window pixels, so that people at its border get a whole window.
_BEYOND = 16
# A box is judged a little larger than it is, in windows up to a stride aside.
_JUDGED_SCALE = 1.06
_JUDGED = (_WINDOW[0] + 2 * _STRIDE[0], _WINDOW[1] + 2 * _STRIDE[1])
_LOWEST_MARGIN = -5.0


def _people_classifier() -> cv2.HOGDescriptor:
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(cv2.HOGDescriptor_getDefaultPeopleDetector())  # type: ignore[attr-defined]
    return hog


# Shared by all threads: `detect` only reads the weights.
_HOG = _people_classifier()


def person_margin(frame: NDArray[np.uint8], box: Box) -> float:
    """Score how much a box looks like an upright person.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    box : Box
        Of an upright person.

    Returns
    -------
    float
        Signed distance from the decision boundary, the highest of a few windows about the box.
    """
    px = _JUDGED_SCALE * box.height / _PERSON_PX
    width, height = (max(1, round(side * px)) for side in _JUDGED)
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    picture = resize(_cut_replicated(frame, (left, top, width, height)), *_JUDGED)
    _, margins = _HOG.detect(picture, -10.0, _STRIDE, (0, 0))
    return max(_LOWEST_MARGIN, float(np.max(margins)))


def person_windows(
    frame: NDArray[np.uint8], min_person_px: float, threshold: float
) -> tuple[Boxes, NDArray[np.float64]]:
    """Windows that look like a person, many for each.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    threshold : float
        Least classifier score; 0 is the decision boundary, lower finds more.

    Returns
    -------
    boxes : (N, 4) float64 array
        Of the person within each window: x, y, width, height in pixels of the frame.
    scores : (N,) float64 array
        Signed distance from the decision boundary.
    """
    found = [(np.zeros((0, 4)), np.zeros(0))]
    factor = _PERSON_PX / min_person_px
    while _PERSON_PX / factor <= 1.15 * frame.shape[0]:
        found.append(_search(frame, factor, threshold))
        factor /= _PYRAMID_STEP
    boxes, scores = zip(*found, strict=True)
    return np.vstack(boxes), np.concatenate(scores)


def _search(
    frame: NDArray[np.uint8], factor: float, threshold: float
) -> tuple[Boxes, NDArray[np.float64]]:
    """Search a frame resized by ``factor``."""
    height, width = frame.shape[:2]
    beyond = int(_BEYOND / factor) + 1
    columns, rows = round((width + 2 * beyond) * factor), round((height + 2 * beyond) * factor)
    if columns < _WINDOW[0] or rows < _WINDOW[1]:
        return np.zeros((0, 4)), np.zeros(0)
    whole = _cut_replicated(frame, (-beyond, -beyond, width + 2 * beyond, height + 2 * beyond))
    corners, values = _HOG.detect(resize(whole, columns, rows), threshold, _STRIDE, (0, 0))
    if len(corners) == 0:
        return np.zeros((0, 4)), np.zeros(0)
    corner = np.asarray(corners, np.float64).reshape(-1, 2)
    boxes = np.empty((len(corner), 4))
    boxes[:, 0] = (corner[:, 0] + _PERSON_X[0] * _WINDOW[0]) / factor - beyond - 0.5
    boxes[:, 1] = (corner[:, 1] + _PERSON_Y[0] * _WINDOW[1]) / factor - beyond - 0.5
    boxes[:, 2] = (_PERSON_X[1] - _PERSON_X[0]) * _WINDOW[0] / factor
    boxes[:, 3] = (_PERSON_Y[1] - _PERSON_Y[0]) * _WINDOW[1] / factor
    return boxes, np.ravel(values).astype(np.float64)


def _cut_replicated(frame: NDArray[np.uint8], window: Window) -> NDArray[np.uint8]:
    """Cut a window out of a frame, replicating its border, which adds no edge."""
    left, top, width, height = window
    rows, columns = frame.shape[:2]
    # A window wholly beyond the frame shows its nearest border.
    x0, x1 = (min(max(x, 0), columns - 1) for x in (left, left + width - 1))
    y0, y1 = (min(max(y, 0), rows - 1) for y in (top, top + height - 1))
    inside = frame[y0 : y1 + 1, x0 : x1 + 1]
    across, down = width - inside.shape[1], height - inside.shape[0]
    before_x, before_y = min(max(0, -left), across), min(max(0, -top), down)
    padded = cv2.copyMakeBorder(
        inside, before_y, down - before_y, before_x, across - before_x, cv2.BORDER_REPLICATE
    )
    return padded.astype(np.uint8, copy=False)
