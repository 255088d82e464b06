"""How a person moves over the ground, and which way they face.

The velocity follows from the box and the camera's elevation. A Bayes filter on the circle of
azimuths follows the heading: single frames confuse front and back, or left and right, above all for
people who are small or seen from the side, but people turn gradually, and mostly walk in the
direction they face.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import softmax
from app.tracking.seen_body import SeenBody
from app.vision.geometry import Box
from index.posture import MIN_RUNNING_SPEED_M_S, MIN_WALKING_SPEED_M_S, PostureName
from index.skeleton import wrap_degrees


@dataclass(frozen=True)
class GroundVelocity:
    """Velocity over the ground, metres per second: to the right of the picture, and away.

    Steps away from a low camera have less weight in ``reliable_speed``, which has little noise.
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
    """Measures a person's velocity from the centre of their box."""

    def __init__(self) -> None:
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
        """Add a frame, with its scale and elevation; return the velocity over the last second.

        The box surrounds the whole person.
        """
        self._elevation_sum_deg += elevation_deg
        self._frames += 1
        self._recent.append((timestamp, box.x + box.width / 2, box.y + box.height / 2, px_per_m))
        while self._recent[0][0] < timestamp - 1.0:
            self._recent.popleft()
        if len(self._recent) < 3:
            return STILL
        times, x, y, scales = np.array(self._recent).T
        times = times - times.mean()
        # A frame that is sent again has the same time.
        metres_per_px = 1 / (np.median(scales) * max(float(times @ times), 1e-6))
        rise = np.sin(np.deg2rad(self.elevation_deg))
        rise = np.copysign(max(abs(rise), np.sin(np.deg2rad(6.0))), rise)
        right, away = times @ x * metres_per_px, -(times @ y) * metres_per_px / rise
        # Elevation from which steps away from the camera count in full for the speed. For a lower
        # camera, such steps hardly change the height in the picture.
        reliable = min(1.0, abs(rise) / np.sin(np.deg2rad(20.0)))
        return GroundVelocity(float(right), float(away), float(np.hypot(right, reliable * away)))


def ground_path(
    pelvis_px: NDArray[np.float64], pixels_per_metre: float, elevation_deg: float
) -> NDArray[np.float64]:
    """Path ``(T, 2)`` of a pelvis over the ground: metres across, and towards the camera.

    ``pelvis_px`` ``(T, 2)`` are its places in the frame.
    """
    # The noise of the path of a low camera must not look like steps.
    sine = max(float(np.sin(np.deg2rad(elevation_deg))), 0.35)
    return np.asarray(pelvis_px / pixels_per_metre / np.array([1.0, sine]))


BINS = 36
"""Number of azimuths in the distribution, over the whole circle."""

# The values below were chosen on UP-Fall's first activities at 0.35 of their size, against their
# full size, and on Pose2Sim's cameras at a tenth of it.

_SEEN_DEG = 20.0  # Standard deviation of the azimuth of a right hypothesis of a small person.
MIN_TURNED_DEG = 2.0
"""Least turn of the shoulders from the exact side view."""

_CENTRES_DEG = (np.arange(BINS) + 0.5) * 360 / BINS - 180
_FRONT = np.abs(_CENTRES_DEG) < 90


@dataclass(frozen=True)
class Heading:
    """The direction a person faces, as the azimuth of the camera about them.

    ``shares`` ``(BINS,)`` are probabilities of azimuths; ``front`` is whether the camera sees the
    front, and changes only on strong evidence.
    """

    shares: NDArray[np.float64]
    front: bool

    @property
    def front_probability(self) -> float:
        """Probability that the camera sees the front."""
        return float(np.clip(self.shares[_FRONT].sum(), 0, 1))

    def on_visible_side(self, azimuth_deg: float) -> float:
        """The nearest azimuth from which the camera sees the same side, front or back, as now."""
        low, high = (0.0, 90 - MIN_TURNED_DEG) if self.front else (90 + MIN_TURNED_DEG, 180.0)
        return float(np.copysign(np.clip(abs(azimuth_deg), low, high), azimuth_deg))

    def log_likelihood(self, azimuths_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log probabilities, finite, that hypotheses at these azimuths ``(N,)`` are right."""
        return np.asarray(np.log(_normal_about(azimuths_deg, _SEEN_DEG) @ self.shares + 1e-4))


class HeadingFilter:
    """Follows the heading of one person."""

    def __init__(self) -> None:
        self._last: tuple[float, Heading] | None = None

    def update(
        self,
        timestamp: float,
        azimuths_deg: NDArray[np.float64],
        weights: NDArray[np.float64],
        clarity: float,
        velocity: GroundVelocity,
    ) -> Heading:
        """Add a frame, with azimuths and weights, of sum 1, of hypotheses ``(N,)``.

        ``clarity`` says how clearly the picture shows the azimuth, 0 to 1.
        """
        shares, independence = np.full(BINS, 1 / BINS), 1.0
        if self._last is not None:
            shares, independence = self._predict(timestamp, *self._last)
        # Standard deviation of the angle between the directions of walking and facing.
        ahead = _normal_about(np.array([_walking_azimuth_deg(velocity)]), 40.0)[0]
        # The direction of walking is measured over a second.
        weight = 0.3 * self.walking_weight(velocity) * independence
        # Share of people walking in any other direction than they face.
        shares = shares * _with_outliers(ahead, 0.1) ** weight
        seen = weights @ _normal_about(azimuths_deg, clarity * 15.0 + (1 - clarity) * _SEEN_DEG)
        # Share of frames in which no hypothesis faces the right way.
        shares = shares * _with_outliers(seen, 0.2) ** independence
        shares /= shares.sum()
        heading = Heading(shares, self._sees_front(float(shares[_FRONT].sum())))
        self._last = timestamp, heading
        return heading

    def walking_weight(self, velocity: GroundVelocity) -> float:
        """Weight of a person's direction of motion, 0 to 1."""
        # From half a metre a second on, in full from one.
        return float(np.clip((velocity.speed - 0.5) / 0.5, 0, 1))

    def _predict(
        self, timestamp: float, before: float, last: Heading
    ) -> tuple[NDArray[np.float64], float]:
        """The predicted distribution, and how independent a frame is of the previous one."""
        elapsed = timestamp - before
        # Standard deviation of the turn of a person within a second.
        shares = last.shares @ _normal_about(_CENTRES_DEG, 80.0 * np.sqrt(elapsed))
        # Rate of jumps to any other heading: detection and identity may be wrong.
        jumps = 1 - float(np.exp(-0.05 * elapsed))
        # Frame rate above which each frame counts less.
        return _with_outliers(shares, jumps), min(1.0, 6.0 * elapsed)

    def _sees_front(self, probability: float) -> bool:
        """Whether the camera sees the front, from the last side and its current probability."""
        if self._last is None:
            return probability >= 0.5
        front = self._last[1].front
        other_side = 1 - probability if front else probability
        # People seen from the side keep front or back.
        return front != (other_side >= 0.8)


def posture_in_motion(posture: PostureName, velocity: GroundVelocity) -> PostureName:
    """The posture of a body, using the measured speed rather than that of a clip."""
    if posture not in ("standing", "walking", "running"):
        return posture
    if velocity.reliable_speed >= MIN_RUNNING_SPEED_M_S:
        return "running"
    return "walking" if velocity.reliable_speed >= MIN_WALKING_SPEED_M_S else "standing"


REFERENCE_HZ = 10.0
"""Frame rate for which likelihoods are given: above it, each frame counts less."""


@dataclass(frozen=True)
class Motion:
    """How a person moves at a frame, and which way they face.

    ``elevation_deg``, of the camera above the person, is averaged over the track; ``walks`` is
    whether the motion shows the heading.
    """

    velocity: GroundVelocity
    heading: Heading
    elevation_deg: float
    walks: bool


class MotionFilter:
    """Follows the velocity and the heading of one person, from what each frame shows of them."""

    def __init__(self) -> None:
        self._ground, self._headings = GroundMotion(), HeadingFilter()
        self._last_at = -math.inf

    def update(self, timestamp: float, box: Box, body: SeenBody) -> Motion:
        velocity = self._ground.update(timestamp, box, body.px_per_m, body.elevation_deg)
        independence = min(1.0, REFERENCE_HZ * (timestamp - self._last_at))
        self._last_at = timestamp
        likelihoods = independence * body.log_likelihoods
        heading = self._headings.update(
            timestamp, body.azimuths_deg, softmax(likelihoods), body.clarity, velocity
        )
        walks = self._headings.walking_weight(velocity) > 0
        return Motion(velocity, heading, self._ground.elevation_deg, walks)


def _walking_azimuth_deg(velocity: GroundVelocity) -> float:
    return float(np.rad2deg(np.arctan2(-velocity.right, -velocity.away)))


def _normal_about(azimuths_deg: NDArray[np.float64], deviation_deg: float) -> NDArray[np.float64]:
    """Normal distributions ``(N, BINS)`` about azimuths ``(N,)``."""
    apart = wrap_degrees(azimuths_deg[:, None] - _CENTRES_DEG)
    mass = np.exp(-((apart / max(deviation_deg, 180 / BINS)) ** 2) / 2)
    return np.asarray(mass / mass.sum(axis=1, keepdims=True))


def _with_outliers(shares: NDArray[np.float64], outlier_share: float) -> NDArray[np.float64]:
    """Mix a distribution with the uniform one."""
    return (1 - outlier_share) * shares + outlier_share / BINS
