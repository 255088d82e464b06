"""How a person moves over the ground, from their boxes and from the poses that fit."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from app.vision.geometry import Box

WINDOW_S = 1.0
FEWEST = 3
"""Frames from which a velocity is computed."""

LEAST_ELEVATION_DEG, SURE_ELEVATION_DEG = 6.0, 20.0
"""Seen from lower, moving away hardly changes the height in the picture: noise would count most.
The direction bears more of it than the speed."""


@dataclass(frozen=True)
class GroundVelocity:
    """Velocity over the ground, metres per second.

    Parameters
    ----------
    right : float
        Towards the right of the picture.
    away : float
        Away from the camera.
    sure_speed : float
        The speed, of which little is noise: from a low camera, steps away count less.
    """

    right: float
    away: float
    sure_speed: float

    @property
    def speed(self) -> float:
        """Metres per second."""
        return float(np.hypot(self.right, self.away))


STILL = GroundVelocity(0.0, 0.0, 0.0)


class GroundMotion:
    """Follows the centre of a person's box, and turns pixels into metres on the ground.

    A person who moves away by ``d`` metres rises in the picture by ``d * sin(elevation)`` metres
    at the person's scale. The camera's elevation, a guess of each frame's hypotheses, is averaged
    over all frames.
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float, float, float]] = deque()
        self._elevations = (0.0, 0)

    @property
    def elevation_deg(self) -> float:
        """Height angle of the camera above the person, averaged over all frames."""
        total, count = self._elevations
        return total / max(count, 1)

    def update(
        self, timestamp: float, box: Box, px_per_m: float, elevation_deg: float
    ) -> GroundVelocity:
        """Take in a frame and return the velocity over the last second.

        Parameters
        ----------
        timestamp : float
            Seconds.
        box : Box
            Of the whole person, pixels.
        px_per_m : float
            Scale of the person in the picture.
        elevation_deg : float
            Of the camera, as this frame's hypotheses have it.
        """
        total, count = self._elevations
        self._elevations = (total + elevation_deg, count + 1)
        self._recent.append((timestamp, box.x + box.width / 2, box.y + box.height / 2, px_per_m))
        while self._recent[0][0] < timestamp - WINDOW_S:
            self._recent.popleft()
        if len(self._recent) < FEWEST:
            return STILL
        times, x, y, scales = np.array(self._recent).T
        times = times - times.mean()
        # A frame that is sent again comes at the same time.
        metres_per_px = 1 / (np.median(scales) * max(float(times @ times), 1e-6))
        rise = np.sin(np.deg2rad(self.elevation_deg))
        least = np.sin(np.deg2rad(LEAST_ELEVATION_DEG))
        rise = np.copysign(max(abs(rise), least), rise)
        right, away = times @ x * metres_per_px, -(times @ y) * metres_per_px / rise
        sure = min(1.0, abs(rise) / np.sin(np.deg2rad(SURE_ELEVATION_DEG)))
        return GroundVelocity(float(right), float(away), float(np.hypot(right, sure * away)))
