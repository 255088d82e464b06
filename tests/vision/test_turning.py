"""Quarter turns: as numpy turns an array, and back."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.vision.people import Box, Silhouette
from app.vision.turning import turned_box, turned_points, turned_shape, turned_silhouette

SHAPE = (30, 50, 3)
TURNS = pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2, 3])


@TURNS
def test_points_go_where_their_pixels_go(turns: int) -> None:
    frame = np.zeros(SHAPE[:2], int)
    frame[7, 31] = 1
    row, column = np.argwhere(np.rot90(frame, turns))[0]
    assert turned_points(np.array([31.0, 7.0]), SHAPE, turns).tolist() == [column, row]
    assert turned_shape(SHAPE, turns) == np.rot90(frame, turns).shape


@TURNS
def test_turning_back_undoes_it(turns: int) -> None:
    points = np.random.default_rng(0).uniform(-10, 60, (4, 5, 2))
    there = turned_points(points, SHAPE, turns)
    assert_allclose(turned_points(there, turned_shape(SHAPE, turns), -turns), points)
    box = Box(3.5, 4.25, 20, 7)
    there_box = turned_box(box, SHAPE, turns)
    assert turned_box(there_box, turned_shape(SHAPE, turns), -turns) == box


@TURNS
def test_silhouettes_turn_with_the_frame(turns: int) -> None:
    crop = np.array([[True, False, True], [True, True, False]])
    silhouette = Silhouette(crop, left=11, top=5, segmenter="mask", truncated=False)
    turned = turned_silhouette(silhouette, SHAPE, turns)
    expected = np.rot90(silhouette.mask(SHAPE), turns)
    assert (turned.mask(turned_shape(SHAPE, turns)) == expected).all()
    assert turned.box == turned_box(silhouette.box, SHAPE, turns)
