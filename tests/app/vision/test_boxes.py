"""Arithmetic on many boxes: the same as one by one, and what merging leaves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.boxes import averaged, drop_parts, intersections, iou_matrix, suppress
from app.vision.geometry import Box

BOXES = np.array([[0, 0, 10, 30], [1, 1, 10, 30], [7, 0, 10, 30], [1, 0, 8, 14]], float)
SCORES = np.array([0.9, 0.8, 0.7, 0.6])

numbers, sizes = st.floats(-50, 50), st.floats(0.5, 60)
some_boxes = st.lists(st.tuples(numbers, numbers, sizes, sizes), min_size=1, max_size=9).map(
    lambda rows: np.array(rows, float)
)


@given(first=some_boxes, second=some_boxes)
def test_overlaps_are_those_of_each_pair(first: np.ndarray, second: np.ndarray) -> None:
    overlaps, shared = iou_matrix(first, second), intersections(first, second)
    for i, one in enumerate(first):
        for j, other in enumerate(second):
            assert overlaps[i, j] == pytest.approx(Box(*one).iou(Box(*other)), abs=1e-9)
            assert shared[i, j] == pytest.approx(Box(*one).intersection(Box(*other)), abs=1e-6)


@given(boxes=some_boxes, seed=st.integers(0, 999), overlap=st.floats(0.05, 0.95))
def test_suppression_keeps_who_is_better_than_all_near(
    boxes: np.ndarray, seed: int, overlap: float
) -> None:
    scores = np.random.default_rng(seed).uniform(0, 1, len(boxes))
    kept = suppress(boxes, scores, overlap)
    overlaps = iou_matrix(boxes, boxes)
    assert scores[kept[0]] == scores.max()
    assert (np.diff(scores[kept]) <= 0).all()
    for position, index in enumerate(kept):
        assert all(overlaps[index, other] < overlap for other in kept[:position])
    for index in set(range(len(boxes))) - set(kept):
        assert any(overlaps[index, o] >= overlap and scores[o] >= scores[index] for o in kept)


def test_nothing_suppressed_of_nothing() -> None:
    assert suppress(np.zeros((0, 4)), np.zeros(0), 0.4) == []


def test_two_people_walking_together_stay_two() -> None:
    kept = suppress(BOXES, SCORES, 0.4)
    assert kept == [0, 2, 3]
    assert drop_parts(BOXES, kept) == [0, 2]


def test_the_mean_box_leans_to_the_better() -> None:
    mean = averaged(BOXES, SCORES, [0])
    assert mean.shape == (1, 4)
    assert 0 < mean[0, 0] < 0.5 and mean[0, 2] == pytest.approx(10)
