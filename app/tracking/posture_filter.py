"""A track's posture: the average, over time, of the shares in its frames."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture_probability import (
    EstimatedPosture,
    likeliest_posture,
    posture_of,
    shares_of,
)
from app.tracking.parameters import DEFAULTS, PostureParameters
from app.vision.frame_posture import FramePosture
from app.vision.geometry import Box
from index.posture import POSTURES

_LYING = np.array([posture == "lying" for posture in POSTURES], np.float64)


class PostureFilter:
    """Averages the postures of a track's frames; the newest has the most weight."""

    def __init__(self, parameters: PostureParameters = DEFAULTS.posture) -> None:
        self._parameters = parameters
        self._shares: NDArray[np.float64] | None = None
        self._presence = 1.0
        self._last_at = -math.inf

    def update(
        self,
        timestamp: float,
        votes: NDArray[np.float64],
        frame_posture: FramePosture | None,
        presence: float,
        box: Box,
        weight: float = 1.0,
    ) -> tuple[EstimatedPosture, NDArray[np.float64]]:
        """Add a frame.

        Parameters
        ----------
        timestamp : float
            Seconds, later than that of the previous frame.
        votes : (10,) float64 array
            Share of each of ``POSTURES`` in the hypotheses of this frame.
        frame_posture : FramePosture or None
            Posture from the landmarks; None if none were read.
        presence : float
            Probability that the landmarks are a person's.
        box : Box
            Box of the person.
        weight : float
            Weight of the frame, 0 to 1.

        Returns
        -------
        posture : EstimatedPosture
            Posture of the track.
        shares : (10,) float64 array
            Shares of this frame alone.
        """
        shares = votes
        if frame_posture is not None:
            # If the network does not recognise the person, only the shape of the box shows lying.
            lying = self._wide(box) * _LYING
            shares = presence * shares_of(frame_posture, votes) + (1 - presence) * lying
            shares = shares + (1 - shares.sum()) * votes
        if self._shares is None:
            self._shares, self._presence = shares, presence
        else:
            elapsed = weight * min(timestamp - self._last_at, self._parameters.max_step_s)
            kept = math.exp(-elapsed / self._parameters.settling_s)
            self._shares = kept * self._shares + (1 - kept) * shares
            self._presence = kept * self._presence + (1 - kept) * presence
        self._last_at = timestamp
        if frame_posture is None:
            return posture_of(self._shares, self._presence), shares
        return likeliest_posture(self._shares, self._presence), shares

    def _wide(self, box: Box) -> float:
        """Probability that the person in a box lies, from its shape alone."""
        narrowness = self._parameters.wide_from * box.height / box.width
        return float(1 / (1 + narrowness**self._parameters.wide_slope))
