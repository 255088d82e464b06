"""Skeletons fitted to keypoints: nearer to them, with the same bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.keypoints import Keypoints, fit_to_keypoints
from index.skeleton import JOINTS, LIMBS, NATIVE, POINT_NAMES, exchange_sides
from index.store import PoseIndex

ROWS = tuple(POINT_NAMES.index(name) for name in LIMBS)
NUMBERS = np.arange(3, 576, 37)


def keypoints_of(points: NDArray[np.float64], rows: tuple[int, ...] = ROWS) -> Keypoints:
    return Keypoints(rows, points[list(rows)], np.full(len(rows), 0.9))


def bone_lengths(points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    parents, children = np.array(NATIVE.bones).T
    return np.linalg.norm(points_3d[..., children, :] - points_3d[..., parents, :], axis=-1)


def apart(points: NDArray[np.float64], keypoints: Keypoints) -> float:
    away = points[list(keypoints.rows)] - keypoints.positions
    return float(np.linalg.norm(away, axis=-1).mean())


@pytest.mark.parametrize("target", range(0, 576, 52))
def test_bones_stay_as_long_and_keypoints_come_nearer(toy_index: PoseIndex, target: int) -> None:
    """Poses that are found near landmarks, among them those that hardly fit."""
    entry = toy_index.entry(target)
    keypoints = keypoints_of(entry.points_normalised)
    nearest = toy_index.landmark_search.nearest(entry.points_3d[list(ROWS)], (0.0,), 60)
    near = (nearest.numbers != target) & ~nearest.mirrored
    points_3d, placed = toy_index.points(nearest.numbers[near])
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert fitted.shape == points_3d.shape and fitted_placed.shape == placed.shape
    assert_allclose(bone_lengths(fitted), bone_lengths(points_3d), rtol=1e-6)
    assert_allclose(fitted[:, 0], 0, atol=1e-12)
    agreement = keypoints.compare(placed, points_3d)
    better = keypoints.compare(fitted_placed, fitted)
    # Left and right may be exchanged.
    before, after = (
        [min(apart(one, keypoints), apart(exchange_sides(one), keypoints)) for one in some]
        for some in (placed, fitted_placed)
    )
    assert np.mean(after) < 0.75 * np.mean(before)
    assert (np.array(after) <= np.array(before) + 0.5).all()
    assert (better.log_likelihood >= agreement.log_likelihood - 0.1).all()


def test_a_wrist_is_followed_and_the_rest_stays(toy_index: PoseIndex) -> None:
    points_3d, placed = toy_index.points(np.array([100]))
    wrist, elbow = (POINT_NAMES.index(f"left_{name}") for name in ("wrist", "elbow"))
    seen = placed[0].copy()
    # Square to the forearm as it is seen, so that its length allows for it.
    forearm = seen[wrist] - seen[elbow]
    seen[wrist] += 6 * np.array([-forearm[1], forearm[0]]) / np.linalg.norm(forearm)
    keypoints = keypoints_of(seen)
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    left = np.linalg.norm(fitted_placed[0, wrist] - seen[wrist])
    assert left < 2.5, f"expected the wrist to come from 6 px to under 2.5, got {left}"
    others = [row for row in range(JOINTS) if row not in (wrist, elbow)]
    assert np.linalg.norm(fitted_placed[0, others] - placed[0, others], axis=-1).max() < 2
    right_leg = [POINT_NAMES.index(f"right_{name}") for name in ("hip", "knee", "ankle", "toe")]
    assert_allclose(fitted[0, right_leg], points_3d[0, right_leg], atol=1e-3)


def test_all_moves_with_keypoints_that_are_moved(toy_index: PoseIndex) -> None:
    """A pose laid a little aside is put in its place, and is the same pose."""
    points_3d, placed = toy_index.points(np.array([200]))
    keypoints = keypoints_of(placed[0] + (3, -2))
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert apart(fitted_placed[0], keypoints) < 0.6
    centred = fitted[0, :JOINTS] - points_3d[0, :JOINTS]
    assert np.linalg.norm(centred, axis=-1).mean() < 0.03


def test_sides_that_are_exchanged_are_fitted_as_they_are_meant(toy_index: PoseIndex) -> None:
    """Keypoints that take left for right pull the other side's points, not across the body."""
    points_3d, placed = toy_index.points(np.array([100]))
    mistaken = keypoints_of(exchange_sides(placed[0]))
    assert mistaken.compare(placed, points_3d).side_log_odds[0] < 0
    fitted, _ = fit_to_keypoints(mistaken, points_3d, placed)
    assert_allclose(fitted, points_3d, atol=1e-9)


def in_depth(keypoints: Keypoints, points_3d: NDArray[np.float64]) -> Keypoints:
    """The same keypoints with the limbs of a pose, seen well."""
    limbs = points_3d[list(ROWS)]
    hips = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
    return replace(
        keypoints, limbs_3d=limbs - limbs[hips].mean(axis=0), limb_scores=np.full(len(ROWS), 0.9)
    )


@pytest.mark.parametrize("target", range(0, 576, 52))
def test_in_depth_bones_stay_as_long_and_the_first_comes_nearest(
    toy_index: PoseIndex, target: int
) -> None:
    entry = toy_index.entry(target)
    keypoints = in_depth(keypoints_of(entry.points_normalised), entry.points_3d)
    points_3d, placed = toy_index.points(NUMBERS)
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert_allclose(bone_lengths(fitted), bone_lengths(points_3d), rtol=1e-6)
    assert_allclose(fitted[:, 0], 0, atol=1e-12)
    assert np.isfinite(fitted_placed).all()

    def away(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.linalg.norm(keypoints.limb_offsets(points), axis=-1).mean(axis=-1)

    # In the picture the fit follows the keypoints; what is left is the depth.
    assert away(fitted)[0] <= away(points_3d)[0] + 1e-9
    swapped = np.roll(np.arange(len(NUMBERS)), 1)
    later, _ = fit_to_keypoints(keypoints, points_3d[swapped], placed[swapped])
    # The same skeleton goes farther towards the landmarks as the first than as another.
    assert away(fitted)[0] <= away(later)[1] + 0.01


@pytest.mark.parametrize("number", [3, 300])
def test_a_pose_that_fits_in_depth_stays(toy_index: PoseIndex, number: int) -> None:
    points_3d, placed = toy_index.points(np.array([number]))
    keypoints = in_depth(keypoints_of(placed[0]), points_3d[0])
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert_allclose(fitted, points_3d, atol=1e-6)
    assert_allclose(fitted_placed, placed, atol=1e-4)
