"""The entries nearest to a silhouette in each rotation, the same as by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptor.silhouette import rotate_silhouette
from index.candidates import (
    MAX_ROTATIONS,
    MIN_ROTATION_SHARE,
    ROTATION_STEP_DEG,
    RotatedQuery,
    find_candidates,
    landmark_rotations,
    silhouette_rotations,
)
from index.search import NearestEntries
from index.store import PoseIndex
from tests.index.helpers import points_of

ATOL = 1e-4
"""Descriptors are float32, of values about 50."""


def bar(height: int, width: int, angle_deg: float = 0.0) -> NDArray[np.uint8]:
    """A silhouette ``(128, 48)`` of a rectangle that is rotated clockwise."""
    return rotate_silhouette(np.ones((height, width), np.uint8), angle_deg)[0]


class TestSilhouetteRotations:
    def test_upright_silhouette_is_searched_upright(self) -> None:
        assert silhouette_rotations(bar(120, 40), 0.0) == (0.0,)

    @pytest.mark.parametrize("angle", [-60.0, -30.0, 45.0, 75.0])
    def test_nearly_square_silhouette_is_searched_along_its_axis_as_well(
        self, angle: float
    ) -> None:
        upright, axis, opposite = silhouette_rotations(bar(100, 70, angle), 0.0)
        assert upright == 0
        assert axis == pytest.approx(angle, abs=3)
        assert abs(axis - opposite) == pytest.approx(180)

    @pytest.mark.parametrize("roll", [-90.0, -60.0, 70.0, 90.0])
    def test_rolled_silhouette_is_searched_both_ways_up(self, roll: float) -> None:
        assert silhouette_rotations(bar(120, 40), roll) == (0.0, -180.0)

    @pytest.mark.parametrize("roll", [-90.0, -80.0, 85.0, 90.0])
    def test_hardly_wide_silhouette_is_searched_unrolled_as_well(self, roll: float) -> None:
        assert silhouette_rotations(bar(60, 50), roll) == (0.0, -180.0, roll)


UPRIGHT = (0.0,)


@given(
    rolls=st.lists(st.floats(-720, 720), min_size=1, max_size=60),
    usual=st.sampled_from([UPRIGHT, (0.0, -180.0), (0.0, 37.0, -143.0)]),
)
def test_landmark_rotations_are_few_and_the_most_frequent(
    rolls: list[float], usual: tuple[float, ...]
) -> None:
    found = landmark_rotations(usual, np.array(rolls))
    assert 1 <= len(found) == len(set(found)) <= MAX_ROTATIONS

    def apart(one: float, other: float) -> float:
        return abs((one - other + 180) % 360 - 180)

    # Each is a usual one or a multiple of a step, at most a step from some roll: half by rounding,
    # half by merging.
    for rotation in found:
        assert rotation in usual or rotation % ROTATION_STEP_DEG == 0
        assert min(apart(rotation, roll) for roll in rolls) <= ROTATION_STEP_DEG + 1e-6
    near = [
        sum(apart(rotation, roll) <= ROTATION_STEP_DEG + 1e-6 for roll in rolls)
        for rotation in found
    ]
    if len(found) > 1:
        assert all(count >= MIN_ROTATION_SHARE * len(rolls) for count in near)


@pytest.mark.parametrize("lean", [-150.0, -90.0, -45.0, 0.0, 30.0, 60.0, 165.0])
def test_the_most_frequent_rotation_comes_first(lean: float) -> None:
    rolls = np.random.default_rng(1).normal(lean, 2, 100)
    assert landmark_rotations(UPRIGHT, rolls)[0] == lean


def test_rotations_near_a_usual_one_are_merged_with_it() -> None:
    assert landmark_rotations((0.0, 37.0), np.array([41.0, 33.0, 37.0, 1.0])) == [37.0, 0.0]


@pytest.mark.parametrize("number", range(3, 576, 83))
def test_candidates_are_the_nearest_entries_and_mirror_images(
    toy_index: PoseIndex, number: int
) -> None:
    silhouette = toy_index.silhouette(number)
    found = find_candidates(toy_index, [RotatedQuery.of(silhouette, 0.0)], 30)
    assert_allclose(found.distances, np.linalg.norm(found.offsets, axis=-1), atol=ATOL)
    both = np.concatenate([toy_index.vectors[:], toy_index.descriptor.mirror(toy_index.vectors[:])])
    query = toy_index.descriptor.describe(silhouette[None])
    all_apart = np.linalg.norm(query.astype(np.float64) - both, axis=-1)
    assert_allclose(found.distances, np.sort(all_apart)[:30], atol=ATOL)
    for row, (entry_id, mirrored) in enumerate(zip(found.entry_ids, found.mirrored, strict=True)):
        points_3d, points_normalised = points_of(toy_index, entry_id, mirrored=mirrored)
        assert_array_equal(found.points_3d[row], points_3d)
        assert_array_equal(found.points_normalised[row], points_normalised)


def test_candidates_of_several_rotations_come_once_and_in_order(toy_index: PoseIndex) -> None:
    queries = [RotatedQuery.of(toy_index.silhouette(77), rotation) for rotation in (0.0, 15.0)]
    searched = find_candidates(toy_index, queries, 30)
    # Of the first rotation, half of them found by the search as well; and the same of the second.
    upright = searched.rotation_deg == 0
    near = NearestEntries(
        np.concatenate([searched.entry_ids[upright][:5], np.arange(5)]),
        np.concatenate([searched.mirrored[upright][:5], np.zeros(5, bool)]),
        np.repeat([-3.0, 22.0], 5),
    )
    found = find_candidates(toy_index, queries, 30, near)
    keys = np.stack([found.entry_ids, found.mirrored, found.rotation_deg], axis=1)
    assert len(np.unique(keys, axis=0)) == len(found) and 60 < len(found) <= 65
    assert (np.diff(found.distances) >= 0).all()
    given = find_candidates(toy_index, queries, 0, near)
    assert sorted(given.rotation_deg) == [0.0] * 5 + [15.0] * 5
    assert_allclose(
        given.distances, np.linalg.norm(given.offsets.astype(np.float64), axis=1), atol=1e-6
    )
