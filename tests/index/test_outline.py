"""Distances between outlines."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from index.outline import outline_distances


class TestOutlineDistances:
    square = np.zeros((128, 48), np.uint8)
    square[40:80, 10:30] = 1

    def test_symmetric(self) -> None:
        other = np.roll(self.square, 5, axis=0)
        other[60:70] = 0
        there = outline_distances(self.square, other[None])[0]
        back = outline_distances(other, self.square[None])[0]
        assert there == pytest.approx(back)
        assert there > 0

    def test_grows_with_a_shift_and_stays_below_it(self) -> None:
        shifts = np.arange(1, 15)
        moved = np.stack([np.roll(self.square, shift, axis=1) for shift in shifts])
        distances = outline_distances(self.square, moved)
        assert (np.diff(distances) > 0).all()
        # Every outline pixel has its own image at the distance of the shift.
        assert (distances <= shifts + 0.1).all()

    def test_frame_within_a_frame(self) -> None:
        # Concentric squares 4 px apart: sides are 4 px away, only corners farther.
        inner = np.zeros_like(self.square)
        inner[44:76, 14:26] = 1
        assert_allclose(outline_distances(self.square, inner[None]), 4, atol=0.3)
