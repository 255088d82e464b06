"""Projection of points in front of a camera, the inverse of its rays."""

import numpy as np
from numpy.typing import NDArray

from app.vision.optics import PinholeCamera


def project(camera: PinholeCamera, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Places ``(..., 2)`` in pixels of points ``(..., 3)`` in front of a camera."""
    points = np.asarray(points, np.float64)
    return points[..., :2] / points[..., 2:] * camera.focal + camera.centre
