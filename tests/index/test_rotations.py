"""In-plane rotation of queries: silhouettes set upright, skeletons rotated back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, normalise, principal_axis_deg
from index.candidates import (
    MAX_ROTATIONS,
    MIN_ROTATION_SHARE,
    ROTATION_STEP_DEG,
    RotatedQuery,
    find_rotated_candidates,
    landmark_rotations,
    rotate_silhouette,
    silhouette_rotations,
)
from index.search import NearestEntries
from index.store import PoseIndex

EVERY_WAY = (-170.0, -90.0, -53.0, 8.0, 90.0, 121.0, 180.0)


def pixels(silhouette: np.ndarray) -> np.ndarray:
    return np.argwhere(silhouette)[:, ::-1].astype(float)


def bar(height: int, width: int, angle_deg: float = 0.0) -> NDArray[np.uint8]:
    """A silhouette ``(128, 48)`` of a rectangle that is rotated clockwise."""
    return rotate_silhouette(np.ones((height, width), np.uint8), angle_deg)[0]


def frame_mask(silhouette: NDArray[np.uint8], left: int = 10, top: int = 4) -> NDArray[np.uint8]:
    """The silhouette, twice as large, somewhere in a frame of 280x160."""
    mask = np.zeros((280, 160), np.uint8)
    large = silhouette.repeat(2, axis=0).repeat(2, axis=1)
    mask[top : top + 2 * HEIGHT, left : left + 2 * WIDTH] = large
    return mask


def assert_differ_only_at_the_outline(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> None:
    kernel = np.ones((3, 3), np.uint8)
    for inner, outer in ((one, other), (other, one)):
        assert not (inner & ~cv2.dilate(outer, kernel) & 1).any()
    assert (one != other).sum() < 0.15 * one.sum()


@pytest.mark.parametrize("angle", EVERY_WAY)
class TestRotateAnyMask:
    def test_rotating_back_restores_the_silhouette(
        self, toy_index: PoseIndex, angle: float
    ) -> None:
        silhouette = toy_index.silhouette(40)
        again = rotate_silhouette(rotate_silhouette(silhouette, angle)[0], -angle)[0]
        # Lying, it is drawn at less than half of the size.
        assert (again & silhouette).sum() / (again | silhouette).sum() > 0.6

    def test_pixels_map_back_to_the_mask(self, toy_index: PoseIndex, angle: float) -> None:
        mask = frame_mask(toy_index.silhouette(40))
        upright, inverse = rotate_silhouette(mask, angle)
        x, y = np.rint(pixels(upright) @ inverse[:, :2].T + inverse[:, 2]).astype(int).T
        assert mask[y, x].mean() > 0.97
        # All of it: as large, up to the scale.
        area = upright.sum() * abs(np.linalg.det(inverse[:, :2]))
        assert area == pytest.approx(mask.sum(), rel=0.04)

    def test_the_inverse_is_a_rotation_and_a_scale(
        self, toy_index: PoseIndex, angle: float
    ) -> None:
        linear = rotate_silhouette(frame_mask(toy_index.silhouette(40)), angle)[1][:, :2]
        scale = np.sqrt(np.linalg.det(linear))
        sine, cosine = np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))
        # Counterclockwise, with y down.
        assert_allclose(linear / scale, [[cosine, sine], [-sine, cosine]], atol=1e-9)

    def test_place_and_size_in_the_frame_do_not_matter(
        self, toy_index: PoseIndex, angle: float
    ) -> None:
        silhouette = toy_index.silhouette(40)
        masks = (
            frame_mask(silhouette),
            frame_mask(silhouette, left=60, top=20),
            silhouette,
            255 * frame_mask(silhouette),
        )
        first, *others = (rotate_silhouette(mask, angle)[0] for mask in masks)
        for other in others:
            assert_differ_only_at_the_outline(first, other)


def test_rotation_by_zero_normalises(toy_index: PoseIndex) -> None:
    mask = frame_mask(toy_index.silhouette(40))
    rotated_by_none, inverse = rotate_silhouette(mask, 0.0)
    expected, placement = normalise(mask)
    assert_differ_only_at_the_outline(rotated_by_none, expected)
    middle = (inverse @ [24, 64, 1])[:2]
    assert_allclose(placement.to_normalised(middle), [24, 64], atol=placement.scale)


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

    # Each is a usual one or a multiple of a step, within one and a half steps of half a step.
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


def test_mirrored_rotations_are_as_likely() -> None:
    rolls = np.array([14.0] * 30 + [-31.0] * 20 + [3.0] * 50)
    assert landmark_rotations(UPRIGHT, rolls) == [0.0, 15.0]
    assert landmark_rotations(UPRIGHT, -rolls) == [0.0, -15.0]


def test_candidates_of_several_rotations_come_once_and_in_order(toy_index: PoseIndex) -> None:
    queries = [RotatedQuery.of(toy_index.silhouette(77), rotation) for rotation in (0.0, 15.0)]
    searched = find_rotated_candidates(toy_index, queries, 30)
    # Of the first rotation, half of them found by the search as well; and the same of the second.
    upright = searched.rotation_deg == 0
    near = NearestEntries(
        np.concatenate([searched.entry_ids[upright][:5], np.arange(5)]),
        np.concatenate([searched.mirrored[upright][:5], np.zeros(5, bool)]),
        np.repeat([-3.0, 22.0], 5),
        np.zeros(10),
    )
    found = find_rotated_candidates(toy_index, queries, 30, near)
    keys = np.stack([found.entry_ids, found.mirrored, found.rotation_deg], axis=1)
    assert len(np.unique(keys, axis=0)) == len(found) and 60 < len(found) <= 65
    assert (np.diff(found.distances) >= 0).all()
    given = find_rotated_candidates(toy_index, queries, 0, near)
    assert sorted(given.rotation_deg) == [0.0] * 5 + [15.0] * 5
    assert_allclose(
        given.distances, np.linalg.norm(given.offsets.astype(np.float64), axis=1), atol=1e-6
    )


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

    @pytest.mark.parametrize("roll", [0.0, 90.0, -70.0])
    @pytest.mark.parametrize("size", [(60, 50), (120, 40)])
    def test_mirror_image_is_searched_at_mirrored_rotations(
        self, roll: float, size: tuple[int, int]
    ) -> None:
        silhouette = bar(*size, 20.0)
        ours = silhouette_rotations(silhouette, roll)
        theirs = silhouette_rotations(np.ascontiguousarray(silhouette[:, ::-1]), -roll)
        assert_allclose(np.cos(np.deg2rad(theirs)), np.cos(np.deg2rad(ours)), atol=0.02)
        assert_allclose(np.sin(np.deg2rad(theirs)), -np.sin(np.deg2rad(ours)), atol=0.02)


@pytest.mark.parametrize("shape", [(12, 1_000_000), (40_000, 3)])
def test_masks_beyond_the_limits_of_opencv_are_rotated(shape: tuple[int, int]) -> None:
    mask = np.ones(shape, np.uint8)
    assert abs(principal_axis_deg(mask)) == pytest.approx(90 if shape[1] > shape[0] else 0, abs=1)
    rotated, inverse = rotate_silhouette(mask, 90.0)
    assert rotated.any()
    rows, columns = np.nonzero(rotated)
    ends = np.stack([columns, rows], axis=1)[[0, -1]] @ inverse[:, :2].T + inverse[:, 2]
    assert np.abs(ends).max() == pytest.approx(max(shape), rel=0.1)


@pytest.mark.parametrize("angle", [0.0, 20.0, 90.0, -135.0])
@pytest.mark.parametrize("length", [400, 4_000, 30_000])
def test_thin_line_stays_unbroken(length: int, angle: float) -> None:
    """However thin it is in the frame, where it covers no pixel by half."""
    rotated, inverse = rotate_silhouette(np.ones((length, 3), np.uint8), angle)
    along = (pixels(rotated) @ inverse[:, :2].T + inverse[:, 2])[:, 1]
    seen, _ = np.histogram(along, bins=24, range=(0, length))
    assert seen.all()
