"""Probabilities, from log odds and scores, and back."""

from typing import TypeVar

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
