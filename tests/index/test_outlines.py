"""Distances between outlines, on shifted and concentric squares."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.matching import outline_distances


@pytest.fixture
def square() -> NDArray[np.uint8]:
    silhouette = np.zeros((128, 48), np.uint8)
    silhouette[40:80, 10:30] = 1
    return silhouette


def test_outline_distance_is_symmetric(square: NDArray[np.uint8]) -> None:
    other = np.roll(square, 5, axis=0)
    other[60:70] = 0
    there = outline_distances(square, other[None])[0]
    assert there == pytest.approx(outline_distances(other, square[None])[0])
    assert there > 0


def test_outline_distance_grows_with_a_shift_and_stays_below_it(square: NDArray[np.uint8]) -> None:
    shifts = np.arange(1, 15)
    distances = outline_distances(square, np.stack([np.roll(square, s, axis=1) for s in shifts]))
    assert (np.diff(distances) > 0).all()
    # Every outline pixel has its own image at the distance of the shift.
    assert (distances <= shifts + 0.1).all()


def test_outline_distance_of_concentric_squares(square: NDArray[np.uint8]) -> None:
    inner = np.zeros_like(square)
    inner[44:76, 14:26] = 1
    # Sides are 4 px apart, only corners farther.
    assert_allclose(outline_distances(square, inner[None]), 4, atol=0.3)
