"""Silhouettes in the formats of COCO's annotations: run lengths and polygons."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Silhouette


def run_lengths(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Count the pixels of a frame down its columns, alternately outside and inside a silhouette.

    Parameters
    ----------
    silhouette : Silhouette
    frame_shape : tuple of int
        Height and width first, as ``frame.shape``.

    Returns
    -------
    (N,) int64 array
        The first counts pixels outside; it is 0 if the first pixel lies inside.
    """
    height, width = frame_shape[:2]
    # Working in one dimension is several times as fast; no run crosses the margin of a column.
    columns = np.pad(silhouette.crop.T, ((0, 0), (1, 1)))
    pixels = columns.ravel()
    changes = np.flatnonzero(pixels[1:] != pixels[:-1])
    column, row = np.divmod(changes, columns.shape[1])
    edges = (silhouette.left + column) * height + silhouette.top + row
    # A run may continue at the top of the next column.
    changes, times = np.unique(edges, return_counts=True)
    ends = np.unique(np.append(changes[times == 1], width * height))
    return np.diff(ends, prepend=0)


def compressed(counts: NDArray[np.int64]) -> str:
    """Write run lengths as pycocotools does.

    From the fourth on, a count is replaced by its difference from the last but one. Each number is
    written in groups of five bits, the lowest first; a sixth bit says whether more follow.
    """
    left = counts.copy()
    left[3:] -= counts[1:-2]
    groups = []
    more = np.ones(len(left), bool)
    while more.any():
        written, bits = more, left & 31
        left >>= 5
        more = written & (left != np.where(bits & 16, -1, 0))
        groups.append(np.where(written, 48 + bits + 32 * more, 0).astype(np.uint8))
    letters = np.array(groups, np.uint8).T.ravel()
    return letters[letters > 0].tobytes().decode()


def polygon(silhouette: Silhouette) -> list[list[float]]:
    """Return the outlines of a silhouette's parts, each ``[x1, y1, x2, y2, ...]`` in frame pixels.

    They run through the centres of the outermost pixels and have at least three points, as COCO
    requires; holes are omitted.
    """
    outlines, _ = cv2.findContours(
        silhouette.crop.astype(np.uint8),
        cv2.RETR_EXTERNAL,
        cv2.CHAIN_APPROX_SIMPLE,
        offset=(silhouette.left, silhouette.top),
    )
    # np.resize repeats the points of an outline that has only one or two.
    return [
        np.resize(outline, (max(3, len(outline)), 2)).ravel().astype(float).tolist()
        for outline in outlines
    ]
