"""Keypoints compared with skeletons, and skeletons fitted to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.landmarks import OUTLIER_WEIGHT, Keypoints, fit_to_keypoints
from index.skeleton import (
    JOINTS,
    LIMB_HIPS,
    LIMB_ROWS,
    LIMBS,
    POINTS,
    bone_lengths,
    exchange_sides,
    rows,
)
from index.store import PoseIndex
from tests.index.helpers import keypoints_of

ROWS = (*LIMB_ROWS, *rows("nose"))
NO_DEPTH = np.zeros((1, POINTS, 3))
"""For keypoints without depth."""

seeds = st.integers(0, 9999)


def skeleton(seed: int) -> NDArray[np.float64]:
    """24 points somewhere in the normalised frame."""
    return np.random.default_rng(seed).uniform((4, 4), (44, 124), (POINTS, 2))


def shown(points: NDArray[np.float64], seed: int = 0) -> Keypoints:
    """Keypoints of unequal scores on the points of a skeleton."""
    scores = np.random.default_rng(seed).uniform(0.2, 1, len(ROWS))
    return Keypoints(ROWS, points[list(ROWS)], scores)


@given(seed=seeds, away=st.floats(0, 80))
def test_skeleton_on_its_keypoints_is_likeliest(seed: int, away: float) -> None:
    points = skeleton(seed)
    moved = points + away * np.random.default_rng(seed + 1).normal(size=points.shape)
    agreement = shown(points, seed).compare(np.stack([points, moved]), NO_DEPTH)
    assert agreement.log_likelihood[0] >= agreement.log_likelihood[1]
    assert (agreement.log_likelihood <= 0).all()
    assert agreement.weights(0.5).max() == 1


@given(seed=seeds, near=st.floats(0, 30), farther=st.floats(0.1, 30))
def test_farther_points_are_less_likely(seed: int, near: float, farther: float) -> None:
    """One point leaves its keypoint; all others stay."""
    points, keypoints = skeleton(seed), shown(skeleton(seed))
    both = np.stack([points, points])
    both[:, ROWS[seed % len(ROWS)], 1] += (near, near + farther)
    likelihood = keypoints.compare(both, NO_DEPTH).log_likelihood
    assert likelihood[1] < likelihood[0]


@given(seed=seeds)
def test_skeleton_is_likelier_than_its_twin_with_sides_exchanged(seed: int) -> None:
    points = skeleton(seed)
    assert shown(points).compare(points[None], NO_DEPTH).side_log_odds[0] > 0


@given(seed=seeds, x=st.floats(-6, 6), y=st.floats(-6, 6))
def test_residuals_point_to_the_keypoints_without_overshooting(
    seed: int, x: float, y: float
) -> None:
    points = skeleton(seed)
    (residuals,) = shown(points).compare(points[None] - (x, y), NO_DEPTH).residuals
    assert residuals.shape == (len(ROWS), 2)
    wanted = np.broadcast_to([x, y], residuals.shape)
    assert (residuals * wanted >= 0).all()
    assert (np.abs(residuals) <= np.abs(wanted) + 1e-12).all()
    # So near, they lead most of the way.
    assert_allclose(residuals, wanted, atol=0.4 * np.hypot(x, y) + 1e-9)


def test_residuals_of_outliers_vanish() -> None:
    points = skeleton(3)
    far = points.copy()
    far[ROWS[0]] += 90
    (residuals,) = shown(points).compare(far[None], NO_DEPTH).residuals
    assert np.abs(residuals[0]).max() < 1e-3


@given(seed=seeds, row=st.integers(0, len(ROWS) - 1))
def test_single_wrong_keypoint_rules_no_skeleton_out(seed: int, row: int) -> None:
    points = skeleton(seed)
    keypoints = shown(points)
    keypoints.positions[row] += 500
    lost = (
        shown(points).compare(points[None], NO_DEPTH).log_likelihood
        - keypoints.compare(points[None], NO_DEPTH).log_likelihood
    )
    assert 0 < lost[0] <= np.log((1 + OUTLIER_WEIGHT) / OUTLIER_WEIGHT) + 1e-9


@given(seed=seeds)
def test_keypoints_of_lower_scores_weigh_less(seed: int) -> None:
    points = skeleton(seed)
    both = np.stack([points, points + 9])
    sure = shown(points)
    unsure = replace(sure, scores=sure.scores / 4)
    spans = [np.ptp(one.compare(both, NO_DEPTH).log_likelihood) for one in (sure, unsure)]
    assert spans[1] < spans[0]


def pose(seed: int) -> NDArray[np.float64]:
    """24 points in metres about the middle of the hips."""
    points = np.random.default_rng(seed).normal(0, 0.4, (POINTS, 3))
    limbs = points[LIMB_ROWS]
    return points - limbs[LIMB_HIPS].mean(axis=0)


def seen_in_depth(seed: int, points_3d: NDArray[np.float64]) -> Keypoints:
    """Keypoints of `shown`, with the limbs of a pose."""
    scores = np.random.default_rng(seed + 7).uniform(0.2, 1, len(LIMBS))
    return replace(
        shown(skeleton(seed), seed), limbs_3d=points_3d[LIMB_ROWS].copy(), limb_scores=scores
    )


@given(seed=seeds, away=st.floats(0.05, 0.6))
def test_pose_on_its_landmarks_is_likeliest_in_depth(seed: int, away: float) -> None:
    points, here = np.stack([skeleton(seed)] * 2), pose(seed)
    moved = here + away * np.random.default_rng(seed + 1).normal(size=here.shape)
    keypoints = seen_in_depth(seed, here)
    agreement = keypoints.compare(points, np.stack([here, moved]))
    assert agreement.log_likelihood[0] > agreement.log_likelihood[1]
    assert (agreement.log_likelihood <= 0).all()
    # Depth only takes from what the picture says.
    flat = replace(keypoints, limbs_3d=None, limb_scores=None).compare(points, NO_DEPTH)
    assert (agreement.log_likelihood <= flat.log_likelihood + 1e-12).all()


@given(seed=seeds, size=st.floats(0.82, 1.22), x=st.floats(-3, 3))
def test_size_and_place_of_landmarks_do_not_matter(seed: int, size: float, x: float) -> None:
    here = pose(seed)
    keypoints = seen_in_depth(seed, here)
    offsets = keypoints.limb_offsets((size * here + x)[None])
    assert_allclose(offsets, 0, atol=1e-9)


@given(seed=seeds, other=seeds)
def test_exchanging_sides_negates_the_side_odds(seed: int, other: int) -> None:
    keypoints = seen_in_depth(seed, pose(seed))
    points, points_3d = skeleton(other), pose(other)
    agreement = keypoints.compare(
        np.stack([points, exchange_sides(points)]), np.stack([points_3d, exchange_sides(points_3d)])
    )
    assert agreement.side_log_odds[0] == pytest.approx(-agreement.side_log_odds[1])
    assert agreement.log_likelihood[0] == pytest.approx(agreement.log_likelihood[1])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"positions": np.zeros((12, 2))}, "expected positions of shape"),
        ({"scores": np.ones(12)}, "expected positions of shape"),
        ({"rows": (*ROWS[:-1], POINTS)}, "expected rows from 0 to 23"),
        ({"rows": (), "positions": np.zeros((0, 2)), "scores": np.zeros(0)}, "expected rows"),
        ({"scores": np.zeros(len(ROWS))}, "expected scores above 0"),
        ({"scores": np.full(len(ROWS), 1.1)}, "expected scores above 0"),
        ({"scores": np.full(len(ROWS), np.nan)}, "expected scores above 0"),
        ({"limbs_3d": np.zeros((12, 3))}, "with their scores, or neither"),
        ({"limbs_3d": np.zeros((11, 3)), "limb_scores": np.ones(11)}, "expected limbs of shape"),
    ],
)
def test_inconsistent_keypoints_are_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(shown(skeleton(0)), **change)


ENTRY_IDS = np.arange(3, 576, 37)


def apart(points: NDArray[np.float64], keypoints: Keypoints) -> float:
    away = points[list(keypoints.rows)] - keypoints.positions
    return float(np.linalg.norm(away, axis=-1).mean())


@pytest.mark.parametrize("target", range(0, 576, 52))
def test_fit_keeps_bone_lengths_and_approaches_keypoints(toy_index: PoseIndex, target: int) -> None:
    """Poses that are found near landmarks, among them those that hardly fit."""
    entry = toy_index.entry(target)
    keypoints = keypoints_of(entry.points_normalised)
    nearest = toy_index.landmark_search.nearest(entry.points_3d[LIMB_ROWS], (0.0,), 60)
    near = (nearest.entry_ids != target) & ~nearest.mirrored
    points_3d, placed = toy_index.points(nearest.entry_ids[near])
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


def test_fit_follows_a_wrist_and_leaves_the_rest(toy_index: PoseIndex) -> None:
    points_3d, placed = toy_index.points(np.array([100]))
    wrist, elbow = rows("left_wrist", "left_elbow")
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
    right_leg = rows("right_hip", "right_knee", "right_ankle", "right_toe")
    assert_allclose(fitted[0, right_leg], points_3d[0, right_leg], atol=1e-3)


def test_fit_follows_shifted_keypoints_without_changing_the_pose(toy_index: PoseIndex) -> None:
    """A pose laid a little aside is put in its place, and is the same pose."""
    points_3d, placed = toy_index.points(np.array([200]))
    keypoints = keypoints_of(placed[0] + (3, -2))
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert apart(fitted_placed[0], keypoints) < 0.6
    centred = fitted[0, :JOINTS] - points_3d[0, :JOINTS]
    assert np.linalg.norm(centred, axis=-1).mean() < 0.03


def test_fit_recognises_exchanged_sides(toy_index: PoseIndex) -> None:
    """Keypoints that take left for right pull the other side's points, not across the body."""
    points_3d, placed = toy_index.points(np.array([100]))
    mistaken = keypoints_of(exchange_sides(placed[0]))
    assert mistaken.compare(placed, points_3d).side_log_odds[0] < 0
    fitted, _ = fit_to_keypoints(mistaken, points_3d, placed)
    assert_allclose(fitted, points_3d, atol=1e-9)


@pytest.mark.parametrize("target", range(0, 576, 52))
def test_fit_in_depth_moves_the_first_skeleton_farthest(toy_index: PoseIndex, target: int) -> None:
    entry = toy_index.entry(target)
    keypoints = keypoints_of(entry.points_normalised, entry.points_3d)
    points_3d, placed = toy_index.points(ENTRY_IDS)
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert_allclose(bone_lengths(fitted), bone_lengths(points_3d), rtol=1e-6)
    assert_allclose(fitted[:, 0], 0, atol=1e-12)
    assert np.isfinite(fitted_placed).all()

    def away(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.linalg.norm(keypoints.limb_offsets(points), axis=-1).mean(axis=-1)

    # In the picture the fit follows the keypoints; what is left is the depth.
    assert away(fitted)[0] <= away(points_3d)[0] + 1e-9
    swapped = np.roll(np.arange(len(ENTRY_IDS)), 1)
    later, _ = fit_to_keypoints(keypoints, points_3d[swapped], placed[swapped])
    # The same skeleton goes farther towards the landmarks as the first than as another.
    assert away(fitted)[0] <= away(later)[1] + 0.01


@pytest.mark.parametrize("number", [3, 300])
def test_pose_that_fits_in_depth_stays(toy_index: PoseIndex, number: int) -> None:
    points_3d, placed = toy_index.points(np.array([number]))
    keypoints = keypoints_of(placed[0], points_3d[0])
    fitted, fitted_placed = fit_to_keypoints(keypoints, points_3d, placed)
    assert_allclose(fitted, points_3d, atol=1e-6)
    assert_allclose(fitted_placed, placed, atol=1e-4)
