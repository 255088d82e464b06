"""Quarter turns: as numpy turns an array, and back."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.vision.geometry import Box
from tests.support.rotation import rotate_box, rotate_points

SHAPE = (30, 50, 3)
TURNS = pytest.mark.parametrize("quarter_turns", [-3, -1, 0, 1, 2, 3])


@TURNS
def test_points_go_where_their_pixels_go(quarter_turns: int) -> None:
    frame = np.zeros(SHAPE[:2], int)
    frame[7, 31] = 1
    row, column = np.argwhere(np.rot90(frame, quarter_turns))[0]
    assert rotate_points(np.array([31.0, 7.0]), SHAPE, quarter_turns).tolist() == [column, row]


@TURNS
def test_turning_back_undoes_it(quarter_turns: int) -> None:
    turned = np.rot90(np.empty(SHAPE[:2]), quarter_turns).shape
    points = np.random.default_rng(0).uniform(-10, 60, (4, 5, 2))
    there = rotate_points(points, SHAPE, quarter_turns)
    assert_allclose(rotate_points(there, turned, -quarter_turns), points)
    box = Box(3.5, 4.25, 20, 7)
    assert rotate_box(rotate_box(box, SHAPE, quarter_turns), turned, -quarter_turns) == box
