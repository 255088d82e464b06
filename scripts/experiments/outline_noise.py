"""Noise on the outline of a silhouette, as the paper disturbs its queries."""

import cv2
import numpy as np
from numpy.typing import NDArray

LEARNED_STD_PX = 3.0
"""Most noise of :func:`outline_faults`."""

_SHIFT = 4
"""Binary digits after the point of a contour point."""


def disturb(
    silhouette: NDArray[np.uint8], std_px: float, generator: np.random.Generator
) -> NDArray[np.uint8]:
    """Move every contour point of a silhouette ``(H, W)`` along its radius by Gaussian noise.

    ``std_px`` is the standard deviation of the change of the radius, which is measured from the
    centroid. Outer contours and holes are filled again, and clipped to the frame.
    """
    if std_px == 0:
        return silhouette.copy()
    contours, _ = cv2.findContours(silhouette, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rows, columns = np.nonzero(silhouette)
    centroid = np.array([columns.mean(), rows.mean()])
    moved = []
    for contour in contours:
        arms = contour[:, 0] - centroid
        radii = np.linalg.norm(arms, axis=1, keepdims=True)
        noise = generator.normal(0.0, std_px, radii.shape)
        points = centroid + arms * (1 + noise / np.maximum(radii, 1e-9))
        moved.append(np.rint(points * 2**_SHIFT).astype(np.int32))
    redrawn = np.zeros_like(silhouette)
    # Together, so that holes stay holes (even-odd rule).
    cv2.fillPoly(redrawn, moved, 1, shift=_SHIFT)
    return redrawn


def disturb_all(silhouettes: NDArray[np.uint8], std_px: float, seed: int) -> NDArray[np.uint8]:
    """Disturb silhouettes ``(B, H, W)``, each with its own noise."""
    generator = np.random.default_rng(seed)
    return np.stack([disturb(silhouette, std_px, generator) for silhouette in silhouettes])


def outline_faults(
    silhouettes: NDArray[np.uint8], joints: NDArray[np.floating], generator: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.floating]]:
    """Add noise that a descriptor learns to overlook: 0 to 3 px, evenly distributed."""
    stds = generator.uniform(0.0, LEARNED_STD_PX, len(silhouettes))
    disturbed = [disturb(s, std, generator) for s, std in zip(silhouettes, stds, strict=True)]
    return np.stack(disturbed), joints
