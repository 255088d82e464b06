"""Distances between the outlines of silhouettes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH


def outline_distances(
    silhouette: NDArray[np.uint8], others: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """Mean distance from each outline to the nearest point of the other, averaged both ways.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
    others : (B, 128, 48) uint8 array

    Returns
    -------
    (B,) float64 array
        Pixels.
    """
    silhouettes = np.concatenate([silhouette[None], others])
    # Shortest paths between two pixels stay within the bounding box of all silhouettes.
    left, top, width, height = cv2.boundingRect(silhouettes.max(axis=0))
    outlines = _outlines(silhouettes[:, top : top + max(1, height), left : left + max(1, width)])
    # Sums of float32 would depend on how many others there are, and on the processor.
    distances = _distance_transforms(outlines).reshape(len(outlines), -1).astype(np.float64)
    on_outline = outlines.reshape(len(outlines), -1).astype(np.float64)
    lengths = np.maximum(on_outline.sum(axis=1), 1)
    from_others = on_outline[1:] @ distances[0] / lengths[1:]
    to_others = distances[1:] @ on_outline[0] / lengths[0]
    return np.asarray((from_others + to_others) / 2)


def _outlines(silhouettes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Outermost pixels of silhouettes ``(B, H, W)``, found in one tall picture."""
    count, height, width = silhouettes.shape
    # A row of background below each separates them.
    padded = np.zeros((count, height + 1, width), np.uint8)
    padded[:, :height] = silhouettes != 0
    eroded = cv2.erode(
        padded.reshape(-1, width),
        np.ones((3, 3), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).reshape(padded.shape)
    return np.asarray((padded != eroded)[:, :height])


def _distance_transforms(outlines: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance ``(B, H, W)`` of each pixel to the outline; the frame's diagonal if it is empty."""
    distances = np.empty(outlines.shape, np.float32)
    for background, distance in zip((~outlines).view(np.uint8), distances, strict=True):
        cv2.distanceTransform(background, cv2.DIST_L2, 3, distance)
    distances[~outlines.any(axis=(1, 2))] = np.hypot(HEIGHT, WIDTH)
    return distances
