"""A track's posture: the shares of its frames, filtered over time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture_probability import (
    EstimatedPosture,
    on_ground_probability,
    posture_of,
    with_bent_legs,
    with_on_ground,
)
from app.vision.geometry import Box, Landmarks

SETTLING_S = 0.4
"""Time constant with which the posture follows the frames."""

MOST_STEP_S = 1.0
"""After a longer gap the newest frame counts no more than after this one."""


WIDE, WIDE_SLOPE = 1.2, 3.0
"""Width over height from which a box rather holds somebody who lies, and how surely it tells."""


def wide(box: Box) -> float:
    """Probability that the person in a box lies, by its shape alone."""
    return float(1 / (1 + (WIDE * box.height / box.width) ** WIDE_SLOPE))


class PostureFilter:
    """Averages the postures of a track's frames, the newest counting most."""

    def __init__(self) -> None:
        self._shares: NDArray[np.float64] | None = None
        self._presence = 1.0
        self._last = -math.inf

    def update(
        self,
        timestamp: float,
        votes: NDArray[np.float64],
        landmarks: Landmarks | None,
        presence: float,
        box: Box,
    ) -> tuple[EstimatedPosture, NDArray[np.float64]]:
        """Take in a frame.

        Parameters
        ----------
        timestamp : float
            Seconds, after those of the frames before.
        votes : (10,) float64 array
            Share of each of ``POSTURES``, of this frame.
        landmarks : Landmarks or None
        presence : float
            Probability that the landmarks are a person's.
        box : Box
            Of the person.

        Returns
        -------
        posture : EstimatedPosture
            Of the track.
        shares : (10,) float64 array
            Of this frame alone.
        """
        shares = votes
        if landmarks is not None:
            # Of somebody whom the network does not make out, the box is all that is seen.
            lies = presence * on_ground_probability(landmarks) + (1 - presence) * wide(box)
            shares = with_on_ground(with_bent_legs(votes, landmarks, presence), lies)
        if self._shares is None:
            self._shares, self._presence = shares, presence
        else:
            kept = math.exp(-min(timestamp - self._last, MOST_STEP_S) / SETTLING_S)
            self._shares = kept * self._shares + (1 - kept) * shares
            self._presence = kept * self._presence + (1 - kept) * presence
        self._last = timestamp
        return posture_of(self._shares, self._presence), shares
