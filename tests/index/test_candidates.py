"""The entries nearest to a silhouette in each rotation, the same as by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptor.silhouette import rotate_silhouette
from index.candidates import (
    RotatedQuery,
    find_candidates,
    landmark_rotations,
    sample_candidates,
    silhouette_rotations,
)
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


UPRIGHT = (0.0,)


@given(
    tilt=st.floats(-720, 720), usual=st.sampled_from([UPRIGHT, (0.0, -180.0), (0.0, 37.0, -143.0)])
)
def test_landmark_rotations_are_the_usual_one_and_that_of_the_trunk(
    tilt: float, usual: tuple[float, ...]
) -> None:
    first, *others = landmark_rotations(usual, tilt)
    assert first == usual[0]

    def apart(one: float) -> float:
        return abs((one - tilt + 180) % 360 - 180)

    (nearest,) = others or [first]
    assert nearest in usual or nearest == tilt
    assert apart(nearest) <= min(apart(one) for one in usual)
    assert apart(nearest) <= 12


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
    found = find_candidates(toy_index, queries, 30)
    keys = np.stack([found.entry_ids, found.mirrored, found.rotation_deg], axis=1)
    assert len(np.unique(keys, axis=0)) == len(found) == 60
    assert (np.diff(found.distances) >= 0).all()
    assert sorted(found.rotation_deg) == [0.0] * 30 + [15.0] * 30


@pytest.mark.parametrize("count", [10, 100, 10**6])
def test_a_sample_is_the_same_for_every_silhouette(toy_index: PoseIndex, count: int) -> None:
    rotations = (0.0, 15.0)
    one, other = (
        sample_candidates(
            toy_index, [RotatedQuery.of(toy_index.silhouette(row), r) for r in rotations], count
        )
        for row in (3, 77)
    )
    keys = [
        set(zip(some.entry_ids.tolist(), some.mirrored.tolist(), some.rotation_deg.tolist(),
                strict=True))
        for some in (one, other)
    ]  # fmt: skip
    assert keys[0] == keys[1]
    assert len(one) == len(keys[0]) == 4 * min(count, len(toy_index))
    assert (np.diff(one.distances) >= 0).all()
