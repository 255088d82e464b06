"""Keypoints compared with skeletons: nearer is likelier, and sides are told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.keypoints import OUTLIER_WEIGHT, Keypoints
from index.search import rotate_clockwise
from index.skeleton import LIMBS, POINT_NAMES, POINTS, exchange_sides

ROWS = (*(POINT_NAMES.index(name) for name in LIMBS), POINT_NAMES.index("nose"))
NO_DEPTH = np.zeros((1, POINTS, 3))
"""Where keypoints have none, skeletons are not compared in it."""

_LIMB_ROWS = [POINT_NAMES.index(name) for name in LIMBS]
_HIPS = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
seeds = st.integers(0, 9999)


def skeleton(seed: int) -> NDArray[np.float64]:
    """24 points somewhere in the normalised frame."""
    return np.random.default_rng(seed).uniform((4, 4), (44, 124), (POINTS, 2))


def shown(points: NDArray[np.float64], seed: int = 0) -> Keypoints:
    """Keypoints of unequal scores on the points of a skeleton."""
    scores = np.random.default_rng(seed).uniform(0.2, 1, len(ROWS))
    return Keypoints(ROWS, points[list(ROWS)], scores)


@given(seed=seeds, away=st.floats(0, 80))
def test_nothing_is_likelier_than_the_keypoints_themselves(seed: int, away: float) -> None:
    points = skeleton(seed)
    moved = points + away * np.random.default_rng(seed + 1).normal(size=points.shape)
    agreement = shown(points, seed).compare(np.stack([points, moved]), NO_DEPTH)
    assert agreement.log_likelihood[0] >= agreement.log_likelihood[1]
    assert (agreement.log_likelihood <= 0).all()
    assert agreement.weights().max() == 1


@given(seed=seeds, near=st.floats(0, 30), farther=st.floats(0.1, 30))
def test_farther_is_less_likely(seed: int, near: float, farther: float) -> None:
    """One point leaves its keypoint; all others stay."""
    points, keypoints = skeleton(seed), shown(skeleton(seed))
    both = np.stack([points, points])
    both[:, ROWS[seed % len(ROWS)], 1] += (near, near + farther)
    own, _ = keypoints.compare_sides(both)
    assert own[1] < own[0]


@given(seed=seeds)
def test_the_skeleton_shown_is_likelier_than_its_twin(seed: int) -> None:
    points = skeleton(seed)
    assert shown(points).compare(points[None], NO_DEPTH).side_log_odds[0] > 0


@given(seed=seeds, x=st.floats(-6, 6), y=st.floats(-6, 6))
def test_residuals_lead_towards_the_keypoints_and_never_past_them(
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


def test_residuals_vanish_where_a_point_is_too_far_to_be_meant() -> None:
    points = skeleton(3)
    far = points.copy()
    far[ROWS[0]] += 90
    (residuals,) = shown(points).compare(far[None], NO_DEPTH).residuals
    assert np.abs(residuals[0]).max() < 1e-3


@given(seed=seeds, row=st.integers(0, len(ROWS) - 1))
def test_one_keypoint_that_misleads_rules_nothing_out(seed: int, row: int) -> None:
    points = skeleton(seed)
    keypoints = shown(points)
    keypoints.positions[row] += 500
    lost = (
        shown(points).compare(points[None], NO_DEPTH).log_likelihood
        - keypoints.compare(points[None], NO_DEPTH).log_likelihood
    )
    assert 0 < lost[0] <= np.log((1 + OUTLIER_WEIGHT) / OUTLIER_WEIGHT) + 1e-9


@given(seed=seeds)
def test_what_is_less_sure_tells_less(seed: int) -> None:
    points = skeleton(seed)
    both = np.stack([points, points + 9])
    sure = shown(points)
    unsure = replace(sure, scores=sure.scores / 4)
    spans = [np.ptp(one.compare_sides(both)[0]) for one in (sure, unsure)]
    assert spans[1] < spans[0]


def pose(seed: int) -> NDArray[np.float64]:
    """24 points in metres about the middle of the hips."""
    points = np.random.default_rng(seed).normal(0, 0.4, (POINTS, 3))
    limbs = points[_LIMB_ROWS]
    return points - limbs[_HIPS].mean(axis=0)


def seen_in_depth(seed: int, points_3d: NDArray[np.float64]) -> Keypoints:
    """Keypoints of `shown`, with the limbs of a pose."""
    scores = np.random.default_rng(seed + 7).uniform(0.2, 1, len(LIMBS))
    return replace(
        shown(skeleton(seed), seed), limbs_3d=points_3d[_LIMB_ROWS].copy(), limb_scores=scores
    )


@given(seed=seeds, away=st.floats(0.05, 0.6))
def test_in_depth_the_pose_shown_is_the_likeliest(seed: int, away: float) -> None:
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
def test_landmarks_of_a_larger_body_somewhere_else_agree(seed: int, size: float, x: float) -> None:
    here = pose(seed)
    keypoints = seen_in_depth(seed, here)
    offsets = keypoints.limb_offsets((size * here + x)[None])
    assert_allclose(offsets, 0, atol=1e-9)


@given(seed=seeds, other=seeds)
def test_exchanging_the_sides_in_depth_as_well_turns_the_odds_over(seed: int, other: int) -> None:
    keypoints = seen_in_depth(seed, pose(seed))
    points, points_3d = skeleton(other), pose(other)
    agreement = keypoints.compare(
        np.stack([points, exchange_sides(points)]), np.stack([points_3d, exchange_sides(points_3d)])
    )
    assert agreement.side_log_odds[0] == pytest.approx(-agreement.side_log_odds[1])
    assert agreement.log_likelihood[0] == pytest.approx(agreement.log_likelihood[1])


@given(seed=seeds, angle=st.floats(-180, 180))
def test_rotated_keypoints_agree_with_rotated_skeletons(seed: int, angle: float) -> None:
    points, points_3d = skeleton(seed + 1), pose(seed + 1)
    keypoints = seen_in_depth(seed, pose(seed))
    turn = np.deg2rad(angle)
    matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    here = keypoints.compare(points[None], points_3d[None])
    there = keypoints.rotated(angle).compare(
        (points @ matrix)[None], rotate_clockwise(points_3d, angle)[None]
    )
    assert_allclose(there.log_likelihood, here.log_likelihood, atol=1e-6)
    assert_allclose(there.side_log_odds, here.side_log_odds, atol=1e-6)
    assert_allclose(keypoints.rotated(angle).rotated(-angle).positions, keypoints.positions)


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
def test_what_makes_no_sense_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(shown(skeleton(0)), **change)
