"""What else is known of where joints are: maps of probability over the normalised frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from index.skeleton import POINTS, exchange_sides

SPREAD_CELLS = 1.5
"""Poses are never quite alike: a point agrees with what a map shows so far about it."""

DOUBT = 0.05
"""Share of the probability that a map misleads: one bad map must not rule a pose out."""

TEMPER = 0.5
"""Points go wrong together (left for right), so together they count less than one by one."""


@dataclass(frozen=True)
class Look:
    """What maps say of some skeletons.

    Parameters
    ----------
    log_likelihood : (K,) float64 array
        Of each skeleton, or of its twin with left and right exchanged, whichever is likelier; at
        most 0, where every point lies at a map's sharp peak.
    side_odds : (K,) float64 array
        How much likelier it is than its twin, in logarithms. Where joints are shows better than
        whose left they are, so the two are told apart.
    pulls : (K, P, 2) float64 array
        From each point of the likelier one to the middle of the probability about it, in pixels of
        the normalised frame, times how much of it there is.
    """

    log_likelihood: NDArray[np.float64]
    side_odds: NDArray[np.float64]
    pulls: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer]) -> Look:
        """Return what is said of some of them."""
        return Look(self.log_likelihood[rows], self.side_odds[rows], self.pulls[rows])

    def weights(self) -> NDArray[np.float64]:
        """How much each skeleton counts, ``(K,)``; 1 for the likeliest."""
        return np.asarray(np.exp(TEMPER * (self.log_likelihood - self.log_likelihood.max())))


@dataclass(frozen=True)
class JointMaps:
    """Where some points of a skeleton are likely to be.

    A point at ``p`` in the normalised frame lies in the cell at ``scale * p + offset``.

    Parameters
    ----------
    rows : tuple of int
        The points, as rows of ``POINT_NAMES``.
    maps : (P, H, W) float32 array
        Probability of each cell; each map sums to 1.
    scale : float
        Cells per pixel.
    offset : (2,) float64 array
        Cells, x before y.
    spread_cells : float
        A point agrees with what a map shows so far about it.
    """

    rows: tuple[int, ...]
    maps: NDArray[np.float32]
    scale: float
    offset: NDArray[np.float64]
    spread_cells: float = SPREAD_CELLS
    _moments: NDArray[np.float32] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.maps.ndim != 3 or len(self.maps) != len(self.rows):
            raise ValueError(f"expected {len(self.rows)} maps, got shape {self.maps.shape}")
        if self.offset.shape != (2,) or not self.scale > 0:
            raise ValueError(
                f"expected a positive scale and an offset of shape (2,), "
                f"got {self.scale} and {self.offset.shape}"
            )
        if not all(0 <= row < POINTS for row in self.rows):
            raise ValueError(f"expected rows from 0 to {POINTS - 1}, got {self.rows}")
        object.__setattr__(self, "_moments", self._smooth())

    def _smooth(self) -> NDArray[np.float32]:
        """Probability about each cell, and its first moments: ``(P, H, W, 3)``."""
        _, height, width = self.maps.shape
        y, x = np.mgrid[:height, :width].astype(np.float32)
        spread = self.spread_cells
        peak = 2 * np.pi * spread**2
        planes = np.stack([self.maps, self.maps * x, self.maps * y], axis=-1)
        smooth = [
            cv2.GaussianBlur(one, (0, 0), spread, borderType=cv2.BORDER_CONSTANT) for one in planes
        ]
        return np.stack(smooth).astype(np.float32) * np.float32(peak)

    def clarity(self) -> float:
        """How clearly the points show: mean log likelihood of each at its map's highest peak.

        At most 0, where every map has one sharp peak; where there is no body there is none.
        """
        peaks = self._moments[..., 0].max(axis=(1, 2))
        return float(np.log((peaks + DOUBT) / (1 + DOUBT)).mean())

    def look(self, points_normalised: NDArray[np.floating]) -> Look:
        """Compare skeletons with the maps.

        Parameters
        ----------
        points_normalised : (K, 24, 2) array
            Pixels of the normalised frame; rows are ``POINT_NAMES``.
        """
        own, own_pulls = self._compared(points_normalised)
        other_sides = exchange_sides(points_normalised.astype(np.float64))
        crossed, crossed_pulls = self._compared(other_sides)
        pulls = np.where((own >= crossed)[:, None, None], own_pulls, crossed_pulls)
        return Look(np.maximum(own, crossed), own - crossed, pulls)

    def _compared(
        self, points_normalised: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Logarithms of the likelihoods ``(K,)`` of skeletons as they are, and pulls."""
        cells = points_normalised[:, list(self.rows)] * self.scale + self.offset
        mass, moment_x, moment_y = self._sampled(cells)
        log_likelihood = np.log((mass + DOUBT) / (1 + DOUBT)).sum(axis=1)
        middle = np.stack([moment_x, moment_y], axis=-1) / np.maximum(mass, 1e-6)[..., None]
        trust = (mass / (mass + DOUBT))[..., None]
        return log_likelihood, trust * (middle - cells) / self.scale

    def _sampled(self, cells: NDArray[np.float64]) -> NDArray[np.float32]:
        """Smoothed mass and moments at cells ``(K, P, 2)``, bilinearly: ``(3, K, P)``."""
        count, height, width = self.maps.shape
        x = np.clip(cells[..., 0], 0, width - 1)
        # The maps lie one below the other.
        y = np.clip(cells[..., 1], 0, height - 1) + height * np.arange(count)
        sampled: NDArray[np.float32] = cv2.remap(
            self._moments.reshape(count * height, width, 3),
            x.astype(np.float32),
            y.astype(np.float32),
            cv2.INTER_LINEAR,
        ).astype(np.float32, copy=False)
        return sampled.transpose(2, 0, 1)
