"""How a person is dressed: colours of the upper and the lower half."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Silhouette

_HUES, _SATURATIONS, _GREYS = 8, 4, 8


def appearance_histogram(frame: NDArray[np.uint8], silhouette: Silhouette) -> NDArray[np.float32]:
    """Colours of a person's upper and lower half.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    silhouette : Silhouette

    Returns
    -------
    (2 * 40,) float32 array
        Hue by saturation, and brightness, of each half; sums to 1.
    """
    rows, columns = silhouette.crop.shape
    left, top = silhouette.left, silhouette.top
    crop = cv2.cvtColor(frame[top : top + rows, left : left + columns], cv2.COLOR_BGR2HSV)
    mask = silhouette.crop.view(np.uint8)
    parts = []
    for half in (np.s_[: (rows + 1) // 2], np.s_[rows // 2 :]):
        pixels, inside = crop[half], mask[half]
        colour = cv2.calcHist([pixels], [0, 1], inside, [_HUES, _SATURATIONS], [0, 180, 0, 256])
        grey = cv2.calcHist([pixels], [2], inside, [_GREYS], [0, 256])
        parts += [colour.ravel(), grey.ravel()]
    histogram = np.concatenate(parts)
    return np.asarray(histogram / max(1.0, float(histogram.sum())), np.float32)


def appearance_distance(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Hellinger distance of two histograms, 0 to 1."""
    return math.sqrt(max(0.0, 1.0 - float(np.sqrt(first * second).sum())))
