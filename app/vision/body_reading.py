"""A reading in three dimensions: corrected depths, on the lines of sight, in camera axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.depth import HIPS, Depths
from app.vision.geometry import PersonWindow
from app.vision.landmark_features import LANDMARKS
from app.vision.network_pass import NetworkPass
from app.vision.people import Landmarks
from app.vision.sight import (
    PinholeCamera,
    place_on_sight_lines,
    roll_rotation,
    to_line_of_sight,
    window_axes,
)

MIN_WEIGHT = 0.05
"""Weight of unseen landmarks when a body is placed."""


@dataclass(frozen=True)
class Body3D:
    """Landmarks in three dimensions.

    Parameters
    ----------
    points : (33, 3) float64 array
        Metres about the middle of the hips, camera axes: x right, y down, z forward.
    sigmas : (33,) float64 array
        Expected absolute error along the line of sight, metres.
    origin : (3,) float64 array
        The middle of the hips, metres from the camera, estimated from the body's size.
    sight : (3, 3) float64 array
        Rotation from camera axes to those of the window's line of sight (without its roll).
    """

    points: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    origin: NDArray[np.float64]
    sight: NDArray[np.float64]

    @property
    def depth_sd(self) -> NDArray[np.float64]:
        """Standard deviations ``(33,)`` of the depths, those of Laplace distributions, metres."""
        return np.asarray(np.sqrt(2) * self.sigmas)

    def along_sight(self, camera: PinholeCamera, landmarks: Landmarks) -> NDArray[np.float64]:
        """The points ``(33, 3)`` in the axes of the line of sight to the hips."""
        hips = landmarks.positions[HIPS].mean(axis=0)
        return np.asarray(self.points @ to_line_of_sight(camera.rays(hips)).T)


def body_of(
    given: NetworkPass,
    window: PersonWindow,
    camera: PinholeCamera,
    depths: Depths,
    places: NDArray[np.float64],
    visibility: NDArray[np.float64],
) -> Body3D:
    """Put the landmarks of a pass onto their lines of sight at corrected depths.

    Parameters
    ----------
    given : NetworkPass
    window : PersonWindow
        The window that was read.
    camera : PinholeCamera
        Camera that took the frame.
    depths : Depths
    places : (33, 2) float64 array
        The landmarks in the frame, pixels.
    visibility : (33,) float64 array
        Probability that each landmark is seen; its weight when the body is placed.
    """
    axes = window_axes(camera, window)
    metres = given.world[:LANDMARKS].astype(np.float64)
    metres = metres - metres[HIPS].mean(axis=0)
    metres[:, 2] = depths.metres
    weights = np.maximum(visibility, MIN_WEIGHT)
    placed = place_on_sight_lines(metres, camera.rays(places), axes, weights)
    hips = placed.points[HIPS].mean(axis=0)
    sight = roll_rotation(-window.roll_deg) @ axes
    return Body3D(placed.points - hips, depths.sigmas, hips, np.asarray(sight))
