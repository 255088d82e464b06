"""What a photograph shows of a skeleton: keypoints, compared with the poses of an index."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from index.skeleton import POINTS, exchange_sides

SPREAD_PX = 8.0
"""Poses are never quite alike: a point agrees with a keypoint so far about it."""

DOUBT = 0.05
"""Share of the probability that a keypoint misleads: one of them must not rule a pose out."""

_LEAST_MASS = 1e-6

TEMPER = 0.5
"""Keypoints go wrong together (left for right), so together they count less than one by one."""


@dataclass(frozen=True)
class Agreement:
    """How skeletons agree with keypoints.

    Parameters
    ----------
    log_likelihood : (K,) float64 array
        Of the keypoints given each skeleton, or its twin with left and right exchanged, whichever
        is likelier; at most 0.
    side_odds : (K,) float64 array
        Log odds of the skeleton against that twin. Keypoints are surer of where a joint is than of
        whose left it is, so the two are told apart.
    pulls : (K, P, 2) float64 array
        From each point of the likelier one to its keypoint, in pixels of the normalised frame, less
        where the two are too far apart to be the same.
    """

    log_likelihood: NDArray[np.float64]
    side_odds: NDArray[np.float64]
    pulls: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer]) -> Agreement:
        """Return that of some skeletons, in the order asked for."""
        return Agreement(self.log_likelihood[rows], self.side_odds[rows], self.pulls[rows])

    def weights(self) -> NDArray[np.float64]:
        """How much each skeleton counts, ``(K,)``; 1 for the likeliest."""
        return np.asarray(np.exp(TEMPER * (self.log_likelihood - self.log_likelihood.max())))


@dataclass(frozen=True)
class Keypoints:
    """Where a photograph shows some points of a skeleton.

    Parameters
    ----------
    rows : tuple of int
        Which points, as rows of ``POINT_NAMES``.
    positions : (P, 2) float64 array
        Pixels of the normalised frame.
    scores : (P,) float64 array
        How sure each is, above 0 and at most 1.
    spread_px : float
        A point agrees with a keypoint so far about it.
    """

    rows: tuple[int, ...]
    positions: NDArray[np.float64]
    scores: NDArray[np.float64]
    spread_px: float = SPREAD_PX

    def __post_init__(self) -> None:
        count = len(self.rows)
        if self.positions.shape != (count, 2) or self.scores.shape != (count,):
            raise ValueError(
                f"expected positions of shape ({count}, 2) and scores of shape ({count},), "
                f"got {self.positions.shape} and {self.scores.shape}"
            )
        if not count or not all(0 <= row < POINTS for row in self.rows):
            raise ValueError(f"expected rows from 0 to {POINTS - 1}, got {self.rows}")
        if not ((self.scores > 0) & (self.scores <= 1)).all():
            raise ValueError(f"expected scores above 0 and at most 1, got {self.scores}")

    def compare(self, points_normalised: NDArray[np.floating]) -> Agreement:
        """Compare skeletons ``(K, 24, 2)`` in pixels of the normalised frame with the keypoints."""
        points = np.asarray(points_normalised, np.float64)
        own, own_pulls = self._compared(points)
        exchanged, exchanged_pulls = self._compared(exchange_sides(points))
        pulls = np.where((own >= exchanged)[:, None, None], own_pulls, exchanged_pulls)
        return Agreement(np.maximum(own, exchanged), own - exchanged, pulls)

    def _compared(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log likelihoods ``(K,)`` of the keypoints given skeletons as they are, and pulls."""
        apart = self.positions - points[:, list(self.rows)]
        squares = (apart**2).sum(axis=-1)
        mass = self.scores * np.exp(-squares / (2 * self.spread_px**2))
        # Single precision, in which modes are interpolated, is slow on what it can hardly tell
        # from nothing.
        mass[mass < _LEAST_MASS] = 0
        trust = mass / (mass + DOUBT)
        return np.log((mass + DOUBT) / (1 + DOUBT)).sum(axis=1), trust[..., None] * apart
