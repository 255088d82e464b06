"""Probabilities and their log odds."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", np.float32, np.float64)

LEAST_PROBABILITY = 1e-3
"""Nothing is taken to be surer than this, or than its opposite."""


def sigmoid(odds: NDArray[Scalar]) -> NDArray[Scalar]:
    """Probabilities of log odds, of the same type; neither 0 nor 1 however large they are."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def probability_of(odds: float) -> float:
    """The probability of log odds."""
    return float(sigmoid(np.array(odds, np.float64)))


def logit(probabilities: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Log odds of probabilities, none of which counts as surer than ``least`` or its opposite."""
    clipped = np.clip(probabilities, least, 1 - least)
    return np.asarray(np.log(clipped / (1 - clipped)))


def log_odds(probability: float) -> float:
    """The log odds of a probability, finite."""
    return float(logit(np.array(probability, np.float64), LEAST_PROBABILITY))
