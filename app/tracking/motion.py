"""Headings over time: a Bayes filter on the circle of azimuths.

Single frames confuse front and back, or left and right, above all for people who are small or seen
from the side. People turn gradually, and mostly walk in the direction they face.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.parameters import DEFAULTS, GroundParameters, HeadingParameters
from app.vision.geometry import Box
from index.skeleton import wrap_degrees


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


BINS = 36
"""Number of azimuths in the distribution, over the whole circle."""

_CENTRES_DEG = (np.arange(BINS) + 0.5) * 360 / BINS - 180
_FRONT = np.abs(_CENTRES_DEG) < 90


@dataclass(frozen=True)
class Heading:
    """The direction a person faces, as the azimuth of the camera about them.

    Parameters
    ----------
    shares : (BINS,) float64 array
        Probabilities of the azimuths.
    front : bool
        Whether the camera sees the front; it changes only on strong evidence.
    """

    shares: NDArray[np.float64]
    front: bool

    @property
    def front_probability(self) -> float:
        """Probability that the camera sees the front."""
        return float(np.clip(self.shares[_FRONT].sum(), 0, 1))

    def on_visible_side(self, azimuth_deg: float, min_turned_deg: float) -> float:
        """The nearest azimuth from which the camera sees the same side, front or back, as now."""
        low, high = (0.0, 90 - min_turned_deg) if self.front else (90 + min_turned_deg, 180.0)
        return float(np.copysign(np.clip(abs(azimuth_deg), low, high), azimuth_deg))

    def log_likelihood(
        self, azimuths_deg: NDArray[np.float64], deviation_deg: float
    ) -> NDArray[np.float64]:
        """Log of the probabilities about azimuths ``(N,)``, finite."""
        return np.asarray(np.log(_normal_about(azimuths_deg, deviation_deg) @ self.shares + 1e-4))


class HeadingFilter:
    """Follows the heading of one person."""

    def __init__(self, parameters: HeadingParameters = DEFAULTS.heading) -> None:
        self._parameters = parameters
        self._last: tuple[float, Heading] | None = None

    def update(
        self,
        timestamp: float,
        azimuths_deg: NDArray[np.float64],
        weights: NDArray[np.float64],
        clarity: float,
        velocity: GroundVelocity,
    ) -> Heading:
        """Add a frame.

        Parameters
        ----------
        timestamp : float
            Seconds, later than the last one.
        azimuths_deg, weights : (N,) float64 arrays
            Azimuths and weights of the frame's hypotheses; weights sum to 1.
        clarity : float
            How clearly the picture shows the azimuth, 0 to 1.
        velocity : GroundVelocity
            Velocity of the person.
        """
        parameters = self._parameters
        shares, independence = np.full(BINS, 1 / BINS), 1.0
        if self._last is not None:
            shares, independence = self._predict(timestamp, *self._last)
        ahead = _normal_about(np.array([_walking_azimuth_deg(velocity)]), parameters.walking_deg)[0]
        weight = parameters.direction_weight * self.walking_weight(velocity) * independence
        shares = shares * _with_outliers(ahead, parameters.backward_share) ** weight
        seen = weights @ _normal_about(
            azimuths_deg,
            clarity * parameters.clearly_seen_deg + (1 - clarity) * parameters.seen_deg,
        )
        shares = shares * _with_outliers(seen, parameters.outlier_share) ** independence
        shares /= shares.sum()
        heading = Heading(shares, self._sees_front(float(shares[_FRONT].sum())))
        self._last = timestamp, heading
        return heading

    def walking_weight(self, velocity: GroundVelocity) -> float:
        """Weight of a person's direction of motion, 0 to 1."""
        low, high = self._parameters.min_walking_m_s, self._parameters.full_walking_m_s
        return float(np.clip((velocity.speed - low) / (high - low), 0, 1))

    def _predict(
        self, timestamp: float, before: float, last: Heading
    ) -> tuple[NDArray[np.float64], float]:
        """The predicted distribution, and how independent a frame is of the previous one."""
        parameters, elapsed = self._parameters, timestamp - before
        shares = last.shares @ _normal_about(_CENTRES_DEG, parameters.turn_deg * np.sqrt(elapsed))
        jumps = 1 - float(np.exp(-parameters.jumps_per_s * elapsed))
        return _with_outliers(shares, jumps), min(1.0, parameters.independent_hz * elapsed)

    def _sees_front(self, probability: float) -> bool:
        """Whether the camera sees the front, from the last side and its current probability."""
        if self._last is None:
            return probability >= 0.5
        front = self._last[1].front
        other_side = 1 - probability if front else probability
        return front != (other_side >= self._parameters.switch_from)


def _walking_azimuth_deg(velocity: GroundVelocity) -> float:
    """Azimuth of a person who walks forwards."""
    return float(np.rad2deg(np.arctan2(-velocity.right, -velocity.away)))


def _normal_about(azimuths_deg: NDArray[np.float64], deviation_deg: float) -> NDArray[np.float64]:
    """Normal distributions ``(N, BINS)`` about azimuths ``(N,)``."""
    apart = wrap_degrees(azimuths_deg[:, None] - _CENTRES_DEG)
    mass = np.exp(-((apart / max(deviation_deg, 180 / BINS)) ** 2) / 2)
    return np.asarray(mass / mass.sum(axis=1, keepdims=True))


def _with_outliers(shares: NDArray[np.float64], outlier_share: float) -> NDArray[np.float64]:
    """Mix a distribution with the uniform one."""
    return (1 - outlier_share) * shares + outlier_share / BINS
