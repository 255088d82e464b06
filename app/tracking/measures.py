"""A track's pose at a frame, with what turns pixels into metres on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.smoothing import Smoothed
from index.skeleton import POINT_NAMES

LEAST_SINE = 0.35
"""Sine of the lowest elevation from which steps towards the camera are measured in the picture."""

_PELVIS = POINT_NAMES.index("pelvis")


@dataclass(frozen=True)
class Measured:
    """A pose at a moment.

    Parameters
    ----------
    timestamp : float
        Seconds.
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis.
    pelvis_px : (2,) float64 array
        In the frame.
    pixels_per_metre : float
        At the person's distance.
    elevation_deg : float
        Of the camera above the person.
    """

    timestamp: float
    points_3d: NDArray[np.float64]
    pelvis_px: NDArray[np.float64]
    pixels_per_metre: float
    elevation_deg: float

    @classmethod
    def of(cls, timestamp: float, smoothed: Smoothed) -> Measured:
        """Measure a smoothed pose."""
        pose = smoothed.pose
        spread_px, spread_m = (
            float(np.linalg.norm(points - points[_PELVIS], axis=1).sum())
            for points in (pose.points_2d, pose.points_3d[:, :2])
        )
        return cls(
            timestamp,
            pose.points_3d - pose.points_3d[_PELVIS],
            pose.points_2d[_PELVIS],
            max(spread_px, 1e-6) / max(spread_m, 1e-6),
            smoothed.elevation_deg,
        )


def ground_path(
    pelvis_px: NDArray[np.float64], pixels_per_metre: float, elevation_deg: float
) -> NDArray[np.float64]:
    """Way of the pelvis over the ground.

    Somebody who walks away from a raised camera moves up in the picture, by the sine of its
    elevation.

    Parameters
    ----------
    pelvis_px : (T, 2) float64 array
    pixels_per_metre : float
    elevation_deg : float

    Returns
    -------
    (T, 2) float64 array
        Metres across the picture and towards the camera.
    """
    sine = max(float(np.sin(np.deg2rad(elevation_deg))), LEAST_SINE)
    return np.asarray(pelvis_px / pixels_per_metre / np.array([1.0, sine]))
