"""Probabilities: from log odds and scores, and back; and filtered over time."""

import math
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

_Float = TypeVar("_Float", np.float32, np.float64)


def sigmoid(odds: NDArray[_Float]) -> NDArray[_Float]:
    """Probabilities of log odds, of the same type; never 0 or 1, however large the odds."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def probability_of(odds: float) -> float:
    """The probability of log odds."""
    return float(sigmoid(np.array(odds, np.float64)))


def logit(probabilities: NDArray[np.float64], min_probability: float) -> NDArray[np.float64]:
    """Log odds of probabilities, which are first clipped to ``min_probability`` from 0 and 1."""
    clipped = np.clip(probabilities, min_probability, 1 - min_probability)
    return np.asarray(np.log(clipped / (1 - clipped)))


def log_odds(probability: float) -> float:
    """The finite log odds of one probability; see :func:`logit`."""
    return float(logit(np.array(probability, np.float64), 1e-3))


def softmax(scores: NDArray[np.floating]) -> NDArray[np.float64]:
    """Probabilities along the last axis."""
    shifted = np.exp(scores - scores.max(axis=-1, keepdims=True), dtype=np.float64)
    return shifted / shifted.sum(axis=-1, keepdims=True)


Change = Literal["begin", "end"]

SETTLING_S, MAX_STEP_S = 0.5, 0.34
"""Time constant for events of a person, and the most time that a single frame counts for: just too
short to begin an event."""


ENDS_BELOW = 0.2
"""Filtered probability below which an event ends."""


class LowPass:
    """A probability, low-pass filtered over ``settling_s``."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._settling_s = settling_s
        self.level = 0.0

    def update(self, probability: float, seconds: float) -> float:
        """Add a frame that counts for ``seconds``; return the filtered probability."""
        kept = math.exp(-seconds / self._settling_s)
        self.level = kept * self.level + (1 - kept) * probability
        return self.level


class Hysteresis(LowPass):
    """A state that follows a low-pass filtered probability."""

    holds = False

    def change(self, probability: float, seconds: float) -> Change | None:
        """Add a frame as :meth:`update` does; return the change of state, if any."""
        level = self.update(probability, seconds)
        # Filtered probability at which an event begins.
        if not self.holds and level >= 0.5:
            self.holds = True
            return "begin"
        if self.holds and level < ENDS_BELOW:
            self.holds = False
            return "end"
        return None

    @property
    def is_unconfirmed(self) -> bool:
        """Whether the event has begun to show but is not certain."""
        return not self.holds and self.level >= ENDS_BELOW
