"""Arithmetic on many boxes at once: arrays ``(N, 4)`` of x, y, width, height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Boxes = NDArray[np.float64]


def iou_matrix(first: Boxes, second: Boxes) -> NDArray[np.float64]:
    """Intersection over union of every pair.

    Parameters
    ----------
    first : (N, 4) float64 array
    second : (M, 4) float64 array

    Returns
    -------
    (N, M) float64 array
    """
    shared = intersections(first, second)
    areas = (first[:, 2] * first[:, 3])[:, None] + (second[:, 2] * second[:, 3])[None, :]
    return np.asarray(shared / (areas - shared))


def intersections(first: Boxes, second: Boxes) -> NDArray[np.float64]:
    """Shared area of every pair, ``(N, M)``."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(
        first[:, None, :2] + first[:, None, 2:], second[None, :, :2] + second[None, :, 2:]
    )
    return np.asarray(np.clip(high - low, 0, None).prod(axis=2))


def suppress(boxes: Boxes, scores: NDArray[np.float64], overlap: float) -> list[int]:
    """Non-maximum suppression: best first, dropping what overlaps a better box too much.

    Parameters
    ----------
    boxes : (N, 4) float64 array
    scores : (N,) float64 array
    overlap : float
        Intersection over union from which two boxes are taken for the same person.

    Returns
    -------
    list of int
        Indices kept, best first.
    """
    overlaps = iou_matrix(boxes, boxes)
    open_ = np.ones(len(boxes), bool)
    kept = []
    for index in np.argsort(-scores, kind="stable"):
        if open_[index]:
            kept.append(int(index))
            open_ &= overlaps[index] < overlap
    return kept


def drop_parts(boxes: Boxes, kept: list[int], share: float = 0.8) -> list[int]:
    """Drop boxes of a head and trunk inside a better box of the whole body, and the reverse.

    Two boxes are of one body if ``share`` of the smaller lies in the other and their axes
    nearly agree; two people walking together have different axes.

    Parameters
    ----------
    boxes : (N, 4) float64 array
    kept : list of int
        Indices, best first.

    Returns
    -------
    list of int
    """
    shared = intersections(boxes, boxes)
    area = boxes[:, 2] * boxes[:, 3]
    axis = boxes[:, 0] + boxes[:, 2] / 2
    result: list[int] = []
    for index in kept:
        inside = any(
            shared[index, other] > share * min(area[index], area[other])
            and abs(axis[index] - axis[other]) < 0.3 * max(boxes[index, 2], boxes[other, 2])
            for other in result
        )
        if not inside:
            result.append(index)
    return result


def averaged(
    boxes: Boxes, scores: NDArray[np.float64], kept: list[int], overlap: float = 0.6
) -> Boxes:
    """Replace each kept box by the mean of the boxes it stands for, the better counting more.

    Parameters
    ----------
    boxes : (N, 4) float64 array
    scores : (N,) float64 array
        Positive.
    kept : list of int
    overlap : float
        Intersection over union with a kept box from which another counts.

    Returns
    -------
    (len(kept), 4) float64 array
    """
    overlaps = iou_matrix(boxes[kept], boxes)
    weights = np.where(overlaps > overlap, overlaps * scores**3, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    corners = weights @ np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])
    return np.hstack([corners[:, :2], corners[:, 2:] - corners[:, :2]])
