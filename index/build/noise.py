"""What real silhouettes have and simulated ones lack: ragged outlines."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, normalise

GRAIN_PX = 1.5
"""How far along the outline an error reaches."""

MARGIN = 8
"""Room about the silhouette for an outline that moves outwards."""


def roughen(
    silhouettes: NDArray[np.uint8], std_px: float, generator: np.random.Generator
) -> NDArray[np.uint8]:
    """Move the outlines of silhouettes in and out at random, and normalise them again.

    Parameters
    ----------
    silhouettes : (B, 128, 48) uint8 array
    std_px : float
        Standard deviation of the shift across the outline, in normalised pixels.
    generator : numpy.random.Generator

    Returns
    -------
    (B, 128, 48) uint8 array
    """
    rough = np.empty_like(silhouettes)
    for row, silhouette in enumerate(silhouettes):
        padded = np.pad(silhouette, MARGIN)
        inside = cv2.distanceTransform(padded, cv2.DIST_L2, 3)
        outside = cv2.distanceTransform(1 - padded, cv2.DIST_L2, 3)
        grain = cv2.GaussianBlur(
            generator.standard_normal((HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN)), (0, 0), GRAIN_PX
        )
        moved = inside - outside + grain * (std_px / grain.std()) > 0
        rough[row] = normalise(moved)[0] if moved.any() else silhouette
    return rough
