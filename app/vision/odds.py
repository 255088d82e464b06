"""Probabilities and their log odds."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", np.float32, np.float64)


def sigmoid(odds: NDArray[Scalar]) -> NDArray[Scalar]:
    """Probabilities of log odds, of the same type; neither 0 nor 1 however large they are."""
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))
