"""OpenCV's people detector: histograms of oriented gradients and a linear classifier.

The detector looks at 64x128 windows in which a person is 96 px tall [1]_. Its windows are
taken from a pyramid of the frame, enlarged as far as the smallest person needs.

References
----------
.. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection", CVPR 2005.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.box_arrays import Boxes
from app.vision.resampling import resize
from app.vision.workers import Workers

_PERSON_PX = 96
_WINDOW = (64, 128)
_STRIDE = (8, 8)
# Coarser than the usual 1.05: half the time, and the boxes are tightened afterwards anyway.
_PYRAMID_STEP = 1.15
# The person inside a window, as shares of its width and height.
_PERSON_X = (0.18, 0.82)
_PERSON_Y = (0.09, 0.93)
# Side of the cells by which the search is guided, in pixels of the frame.
_CELL = 4
# A blob taller than so many people of a size is a larger person, or a crowd of larger ones.
_TALLEST_BLOB = 2.5
# Room beyond the frame, in window pixels, so that people at its border get a whole window.
_BEYOND = 16

_Area = tuple[int, int, int, int]


def _people_classifier() -> cv2.HOGDescriptor:
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(cv2.HOGDescriptor_getDefaultPeopleDetector())  # type: ignore[attr-defined]
    return hog


# One for all threads: once its weights are set, `detect` only reads them.
_HOG = _people_classifier()


def person_windows(
    frame: NDArray[np.uint8],
    min_person_px: float,
    threshold: float,
    worth_searching: Callable[[float], NDArray[np.bool_]] | None = None,
    workers: Workers | None = None,
) -> tuple[Boxes, NDArray[np.float64]]:
    """Windows that look like a person, many for each.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    threshold : float
        Least classifier score; 0 is the classifier's own border, lower finds more.
    worth_searching : callable, optional
        The height of people in pixels to where such may be, by :func:`as_cells`; windows
        elsewhere are not looked at. None searches everywhere.
    workers : Workers, optional
        Who searches for people of several sizes; by default the caller's thread.

    Returns
    -------
    boxes : (N, 4) float64 array
        Of the person within each window: x, y, width, height in pixels of the frame.
    scores : (N,) float64 array
        Signed distance from the classifier's border.
    """
    height = frame.shape[0]
    tasks: list[tuple[_Area, float]] = []
    factor = _PERSON_PX / min_person_px
    while _PERSON_PX / factor <= 1.15 * height:
        person_px = _PERSON_PX / factor
        worth = None if worth_searching is None else worth_searching(person_px)
        tasks += [(area, factor) for area in _areas(frame.shape, worth, person_px)]
        factor /= _PYRAMID_STEP
    found = (workers or Workers()).map(lambda task: _search(frame, *task, threshold), tasks)
    boxes, scores = zip((np.zeros((0, 4)), np.zeros(0)), *found, strict=True)
    return np.vstack(boxes), np.concatenate(scores)


def as_cells(somebody: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where people may be, ``(H, W)``, on a grid of cells of 4 px: a twentieth of one counts."""
    height, width = somebody.shape
    size = max(1, width // _CELL), max(1, height // _CELL)
    return resize(somebody.astype(np.float32), *size) > 0.05


def _areas(
    shape: tuple[int, ...], worth_searching: NDArray[np.bool_] | None, person_px: float
) -> Iterator[_Area]:
    """Parts of the frame to search for people of one size: left, top, right, bottom."""
    height, width = shape[:2]
    if worth_searching is None:
        yield 0, 0, width, height
        return
    # Blobs nearer than a third of a body may be parts of one person.
    reach = max(1, round(0.35 * person_px / _CELL))
    kernel: NDArray[np.uint8] = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    grown = cv2.dilate(_without_tall(worth_searching, _TALLEST_BLOB * person_px / _CELL), kernel)
    count, _, stats, _ = cv2.connectedComponentsWithStats(grown)
    for left, top, columns, rows, _ in stats[1:count].tolist():
        inner_width, inner_height = columns - 2 * reach, rows - 2 * reach
        if inner_height * _CELL < 0.4 * person_px or inner_width * _CELL < 0.08 * person_px:
            continue  # too small to be a person of this size
        aside, above = 0.25 * person_px, 0.3 * person_px
        yield (
            int(left * _CELL - aside),
            int(top * _CELL - above),
            int((left + columns) * _CELL + aside),
            int((top + rows) * _CELL + above),
        )


def _without_tall(mask: NDArray[np.bool_], most_rows: float) -> NDArray[np.uint8]:
    """Drop connected parts taller than ``most_rows``: 1 on what remains, 0 elsewhere."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    kept = stats[:, cv2.CC_STAT_HEIGHT] <= most_rows
    kept[0] = False
    return np.asarray(kept[labels], np.uint8)


def _search(
    frame: NDArray[np.uint8], area: _Area, factor: float, threshold: float
) -> tuple[Boxes, NDArray[np.float64]]:
    """Search one part of the frame, resized by ``factor``."""
    height, width = frame.shape[:2]
    beyond = int(_BEYOND / factor) + 1
    left, top = max(area[0], -beyond), max(area[1], -beyond)
    right, bottom = min(area[2], width + beyond), min(area[3], height + beyond)
    if area == (0, 0, width, height):
        left, top, right, bottom = -beyond, -beyond, width + beyond, height + beyond
    columns, rows = round((right - left) * factor), round((bottom - top) * factor)
    if columns < _WINDOW[0] or rows < _WINDOW[1]:
        return np.zeros((0, 4)), np.zeros(0)
    part = cv2.copyMakeBorder(
        frame[max(0, top) : bottom, max(0, left) : right],
        max(0, -top),
        max(0, bottom - height),
        max(0, -left),
        max(0, right - width),
        cv2.BORDER_REPLICATE,
    ).astype(np.uint8, copy=False)
    corners, values = _HOG.detect(resize(part, columns, rows), threshold, _STRIDE, (0, 0))
    if len(corners) == 0:
        return np.zeros((0, 4)), np.zeros(0)
    corner = np.asarray(corners, np.float64).reshape(-1, 2)
    boxes = np.empty((len(corner), 4))
    boxes[:, 0] = (corner[:, 0] + _PERSON_X[0] * _WINDOW[0]) / factor + left - 0.5
    boxes[:, 1] = (corner[:, 1] + _PERSON_Y[0] * _WINDOW[1]) / factor + top - 0.5
    boxes[:, 2] = (_PERSON_X[1] - _PERSON_X[0]) * _WINDOW[0] / factor
    boxes[:, 3] = (_PERSON_Y[1] - _PERSON_Y[0]) * _WINDOW[1] / factor
    return boxes, np.ravel(values).astype(np.float64)
