"""Motion over the ground, from where a person is in the picture.

A person who moves away by ``d`` metres rises in the picture by ``d * sin(elevation)`` metres at
their scale. For a low camera that sine is small and noise would dominate, so it has a minimum,
which differs between two uses. A velocity (:class:`GroundMotion`) gives headings, whose direction
has to be right: its minimum is low, and steps away have less weight in ``reliable_speed``. A path
(:func:`ground_path`) gives features of actions, whose speeds have to be right: its minimum is high,
and the weights of actions were trained with it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.parameters import DEFAULTS, GroundParameters
from app.vision.geometry import Box


@dataclass(frozen=True)
class GroundVelocity:
    """Velocity over the ground, metres per second.

    Parameters
    ----------
    right : float
        Velocity towards the right of the picture.
    away : float
        Velocity away from the camera.
    reliable_speed : float
        A speed with little noise: for a low camera, steps away from it have less weight.
    """

    right: float
    away: float
    reliable_speed: float

    @property
    def speed(self) -> float:
        """Metres per second."""
        return float(np.hypot(self.right, self.away))


STILL = GroundVelocity(0.0, 0.0, 0.0)


class GroundMotion:
    """Measures a person's velocity from the centre of their box.

    The camera's elevation, which each frame's hypotheses estimate, is averaged over all frames.
    """

    def __init__(self, parameters: GroundParameters = DEFAULTS.ground) -> None:
        self._parameters = parameters
        self._recent: deque[tuple[float, float, float, float]] = deque()
        self._elevation_sum_deg = 0.0
        self._frames = 0

    @property
    def elevation_deg(self) -> float:
        """Elevation of the camera above the person, averaged over all frames."""
        return self._elevation_sum_deg / max(self._frames, 1)

    def update(
        self, timestamp: float, box: Box, px_per_m: float, elevation_deg: float
    ) -> GroundVelocity:
        """Add a frame and return the velocity over the last second.

        Parameters
        ----------
        timestamp : float
            Seconds.
        box : Box
            Box of the whole person, pixels.
        px_per_m : float
            Scale of the person in the picture.
        elevation_deg : float
            Elevation of the camera, from this frame's hypotheses.
        """
        parameters = self._parameters
        self._elevation_sum_deg += elevation_deg
        self._frames += 1
        self._recent.append((timestamp, box.x + box.width / 2, box.y + box.height / 2, px_per_m))
        while self._recent[0][0] < timestamp - parameters.window_s:
            self._recent.popleft()
        if len(self._recent) < parameters.min_frames:
            return STILL
        times, x, y, scales = np.array(self._recent).T
        times = times - times.mean()
        # A frame that is sent again has the same time.
        metres_per_px = 1 / (np.median(scales) * max(float(times @ times), 1e-6))
        rise = np.sin(np.deg2rad(self.elevation_deg))
        min_rise = np.sin(np.deg2rad(parameters.min_elevation_deg))
        rise = np.copysign(max(abs(rise), min_rise), rise)
        right, away = times @ x * metres_per_px, -(times @ y) * metres_per_px / rise
        reliable = min(1.0, abs(rise) / np.sin(np.deg2rad(parameters.reliable_elevation_deg)))
        return GroundVelocity(float(right), float(away), float(np.hypot(right, reliable * away)))


def ground_path(
    pelvis_px: NDArray[np.float64],
    pixels_per_metre: float,
    elevation_deg: float,
    parameters: GroundParameters = DEFAULTS.ground,
) -> NDArray[np.float64]:
    """Path of the pelvis over the ground.

    Parameters
    ----------
    pelvis_px : (T, 2) float64 array
        Pelvis in the frame.
    pixels_per_metre : float
        Scale of the person in the picture.
    elevation_deg : float
        Elevation of the camera above the person.

    Returns
    -------
    (T, 2) float64 array
        Metres across the picture and towards the camera.
    """
    sine = max(float(np.sin(np.deg2rad(elevation_deg))), parameters.min_path_sine)
    return np.asarray(pelvis_px / pixels_per_metre / np.array([1.0, sine]))
