"""Where a person is expected next."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box

# Shares of the difference between the predicted and the seen place that correct place, velocity
# and size.
_PLACE_GAIN, _VELOCITY_GAIN, _SIZE_GAIN = 0.7, 0.3, 0.3
# Seconds in which the velocity of somebody unseen falls to 1/e.
_DRIFT_S = 1.0
_LEAST_S = 1e-3


class MotionFilter:
    """Place and size of a person's box, at constant velocity.

    The place is the middle of the lower edge, where the person stands.

    Parameters
    ----------
    box : Box
    timestamp : float
        Seconds.
    """

    def __init__(self, box: Box, timestamp: float) -> None:
        self._place = box.foot
        self._size = np.array([box.width, box.height])
        self.timestamp = timestamp
        """Of the last correction, in seconds."""
        self.velocity = np.zeros(2)
        """Pixels a second, right and down."""
        self.seen = box
        """As it was last corrected by, before any smoothing."""

    def predict(self, timestamp: float) -> Box:
        """Box at a later time; it may lie outside the frame."""
        place = self._predicted_place(timestamp - self.timestamp)
        width, height = self._size.tolist()
        return Box(float(place[0]) - width / 2, float(place[1]) - height, width, height)

    def update(self, box: Box, timestamp: float, *, whole: bool) -> None:
        """Take in where the person was seen.

        Parameters
        ----------
        box : Box
        timestamp : float
        whole : bool
            Whether all of the person was seen; else the size does not shrink.
        """
        # A frame that is sent again comes at the same time.
        elapsed = max(timestamp - self.timestamp, _LEAST_S)
        predicted = self._predicted_place(elapsed)
        growth = np.array([box.width, box.height]) - self._size
        error = box.foot - predicted
        self._place = predicted + _PLACE_GAIN * error
        # The longer the gap, the more of the error is due to the velocity alone.
        gain = _VELOCITY_GAIN / elapsed if elapsed < 1 else 1 / elapsed
        self.velocity = self.velocity + gain * error
        self._size = self._size + _SIZE_GAIN * (growth if whole else np.maximum(growth, 0))
        self.timestamp = timestamp
        self.seen = box

    def _predicted_place(self, elapsed: float) -> NDArray[np.float64]:
        travel = _DRIFT_S * (1 - math.exp(-elapsed / _DRIFT_S))
        return np.asarray(self._place + travel * self.velocity)
