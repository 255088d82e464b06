"""Which way somebody is turned, over time: a Bayes filter on the circle of azimuths.

Single frames take the front for the back, or left for right, of small people and of those seen from
the side above all. People turn steadily, and mostly go where they face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.ground_motion import GroundVelocity
from index.skeleton import wrap_degrees

BINS = 36

# What follows was chosen on UP-Fall's first activities at 0.35 of their size, against their full
# size, and on Pose2Sim's cameras at a tenth of it.
TURN_DEG = 80.0
"""Deviation of a turn within a second."""

SUDDEN_PER_S = 0.05
"""Rate at which somebody turns up facing anywhere: detection and identity may be wrong."""

SEEN_DEG, SURELY_SEEN_DEG = 20.0, 15.0
"""Deviation of the azimuth of a right hypothesis: of small people, and of large ones."""

OUTLIER_SHARE = 0.2
"""Share of frames in which no hypothesis faces the right way."""

HEADING_DEG, OTHERWISE = 40.0, 0.1
"""Deviation of the way somebody goes from where they face, and share of those who go otherwise."""

HEADING_WEIGHT = 0.3
"""Weight of the way beside what a frame shows: it is measured over a second."""

SLOWEST_M_S, SURELY_M_S = 0.5, 1.0
"""Speed from which the way somebody goes counts, and from which it counts in full."""

SWITCH_FROM = 0.8
"""Probability from which front and back are exchanged: who is seen from the side stays on one."""

BESIDE_DEG = 2.0
"""How far from the exact side view shoulders are at least turned."""

RATE = 6.0
"""Frames a second of which each is evidence of its own; of more frames, each counts less."""

_CENTRES_DEG = (np.arange(BINS) + 0.5) * 360 / BINS - 180
_FRONT = np.abs(_CENTRES_DEG) < 90


@dataclass(frozen=True)
class Turn:
    """Which way somebody is turned.

    Parameters
    ----------
    shares : (BINS,) float64 array
        Probabilities of azimuths, of the camera about the person.
    front : bool
        Whether the camera sees the front, as long as little speaks against it.
    """

    shares: NDArray[np.float64]
    front: bool

    @property
    def front_probability(self) -> float:
        """Probability that the camera sees the front."""
        return float(np.clip(self.shares[_FRONT].sum(), 0, 1))

    def on_its_side(self, azimuth_deg: float) -> float:
        """The nearest azimuth from which the camera sees the front, or the back, as it does."""
        least, most = (0.0, 90 - BESIDE_DEG) if self.front else (90 + BESIDE_DEG, 180.0)
        return float(np.copysign(np.clip(abs(azimuth_deg), least, most), azimuth_deg))

    def log_likelihood(self, azimuths_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log of the shares about azimuths ``(N,)``, finite."""
        return np.asarray(np.log(_about(azimuths_deg, SEEN_DEG) @ self.shares + 1e-4))


class HeadingFilter:
    """Follows which way one person is turned."""

    def __init__(self) -> None:
        self._last: tuple[float, Turn] | None = None

    def update(
        self,
        timestamp: float,
        azimuths_deg: NDArray[np.float64],
        weights: NDArray[np.float64],
        sure: float,
        velocity: GroundVelocity,
    ) -> Turn:
        """Take in a frame.

        Parameters
        ----------
        timestamp : float
            Seconds, later than the last one.
        azimuths_deg, weights : (N,) float64 arrays
            Of the frame's hypotheses; weights sum to 1.
        sure : float
            How surely the picture shows them, 0 to 1.
        velocity : GroundVelocity
        """
        shares, independence, front = np.full(BINS, 1 / BINS), 1.0, None
        if self._last is not None:
            before, last = self._last
            elapsed = timestamp - before
            independence, front = min(1.0, RATE * elapsed), last.front
            shares = last.shares @ _about(_CENTRES_DEG, TURN_DEG * np.sqrt(elapsed))
            shares = _with_outliers(shares, 1 - float(np.exp(-SUDDEN_PER_S * elapsed)))
        ahead = _about(np.array([_ahead_deg(velocity)]), HEADING_DEG)[0]
        weight = HEADING_WEIGHT * going(velocity) * independence
        shares = shares * _with_outliers(ahead, OTHERWISE) ** weight
        seen = weights @ _about(azimuths_deg, sure * SURELY_SEEN_DEG + (1 - sure) * SEEN_DEG)
        shares = shares * _with_outliers(seen, OUTLIER_SHARE) ** independence
        shares /= shares.sum()
        probability = float(shares[_FRONT].sum())
        if front is None:
            front = probability >= 0.5
        elif (1 - probability if front else probability) >= SWITCH_FROM:
            front = not front
        turn = Turn(shares, front)
        self._last = timestamp, turn
        return turn


def going(velocity: GroundVelocity) -> float:
    """How surely somebody goes somewhere, 0 to 1."""
    return float(np.clip((velocity.speed - SLOWEST_M_S) / (SURELY_M_S - SLOWEST_M_S), 0, 1))


def _ahead_deg(velocity: GroundVelocity) -> float:
    """Azimuth of somebody who goes forwards."""
    return float(np.rad2deg(np.arctan2(-velocity.right, -velocity.away)))


def _about(azimuths_deg: NDArray[np.float64], deviation_deg: float) -> NDArray[np.float64]:
    """Normal distributions ``(N, BINS)`` about azimuths ``(N,)``."""
    apart = wrap_degrees(azimuths_deg[:, None] - _CENTRES_DEG)
    mass = np.exp(-((apart / max(deviation_deg, 180 / BINS)) ** 2) / 2)
    return np.asarray(mass / mass.sum(axis=1, keepdims=True))


def _with_outliers(shares: NDArray[np.float64], outliers: float) -> NDArray[np.float64]:
    """The same, a share of which may be anywhere."""
    return (1 - outliers) * shares + outliers / BINS
