"""Quarter turns: as numpy turns an array, and back."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.vision.people import Box, ObservedKeypoints, Silhouette
from scripts.experiments.rotation import (
    rotate_box,
    rotate_keypoints,
    rotate_points,
    rotate_shape,
    rotate_silhouette,
)

SHAPE = (30, 50, 3)
TURNS = pytest.mark.parametrize("quarter_turns", [-3, -1, 0, 1, 2, 3])


@TURNS
def test_points_go_where_their_pixels_go(quarter_turns: int) -> None:
    frame = np.zeros(SHAPE[:2], int)
    frame[7, 31] = 1
    row, column = np.argwhere(np.rot90(frame, quarter_turns))[0]
    assert rotate_points(np.array([31.0, 7.0]), SHAPE, quarter_turns).tolist() == [column, row]
    assert rotate_shape(SHAPE, quarter_turns) == np.rot90(frame, quarter_turns).shape


@TURNS
def test_turning_back_undoes_it(quarter_turns: int) -> None:
    points = np.random.default_rng(0).uniform(-10, 60, (4, 5, 2))
    there = rotate_points(points, SHAPE, quarter_turns)
    assert_allclose(
        rotate_points(there, rotate_shape(SHAPE, quarter_turns), -quarter_turns), points
    )
    box = Box(3.5, 4.25, 20, 7)
    there_box = rotate_box(box, SHAPE, quarter_turns)
    assert rotate_box(there_box, rotate_shape(SHAPE, quarter_turns), -quarter_turns) == box


@TURNS
def test_silhouettes_turn_with_the_frame(quarter_turns: int) -> None:
    crop = np.array([[True, False, True], [True, True, False]])
    silhouette = Silhouette(crop, left=11, top=5, segmenter="mask", truncated=False)
    turned = rotate_silhouette(silhouette, SHAPE, quarter_turns)
    expected = np.rot90(silhouette.mask(SHAPE), quarter_turns)
    assert (turned.mask(rotate_shape(SHAPE, quarter_turns)) == expected).all()
    assert turned.box == rotate_box(silhouette.box, SHAPE, quarter_turns)


@TURNS
def test_keypoints_turn_with_the_frame_and_back(quarter_turns: int) -> None:
    rng = np.random.default_rng(2)
    keypoints = ObservedKeypoints(rng.uniform(-10, 60, (17, 2)), rng.uniform(0, 1, 17))
    turned = rotate_keypoints(keypoints, SHAPE, quarter_turns)
    assert_allclose(turned.positions, rotate_points(keypoints.positions, SHAPE, quarter_turns))
    assert turned.scores is keypoints.scores
    back = rotate_keypoints(turned, rotate_shape(SHAPE, quarter_turns), -quarter_turns)
    assert_allclose(back.positions, keypoints.positions)
