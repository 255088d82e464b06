"""Landmarks compared with skeletons, and skeletons fitted to them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.landmarks import (
    OUTLIER_WEIGHT,
    Agreement,
    NormalisedLandmarks,
    fit_to_landmarks,
    fused_distances,
)
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
from tests.index.helpers import landmarks_of

ROWS = (*LIMB_ROWS, *rows("nose"))

seeds = st.integers(0, 9999)


def skeleton(seed: int) -> NDArray[np.float64]:
    """24 points somewhere in the normalised frame."""
    return np.random.default_rng(seed).uniform((4, 4), (44, 124), (POINTS, 2))


def pose(seed: int) -> NDArray[np.float64]:
    """24 points in metres about the middle of the hips."""
    points = np.random.default_rng(seed).normal(0, 0.4, (POINTS, 3))
    return points - points[LIMB_ROWS][LIMB_HIPS].mean(axis=0)


def shown(seed: int) -> NormalisedLandmarks:
    """Landmarks of unequal scores on the points of :func:`skeleton` and :func:`pose`."""
    generator = np.random.default_rng(seed + 7)
    return NormalisedLandmarks(
        ROWS,
        skeleton(seed)[list(ROWS)],
        generator.uniform(0.2, 1, len(ROWS)),
        pose(seed)[LIMB_ROWS],
        generator.uniform(0.2, 1, len(LIMBS)),
        0.15**2 * np.eye(len(LIMBS)),
    )


def compared(
    landmarks: NormalisedLandmarks, seed: int, *skeletons: NDArray[np.float64]
) -> Agreement:
    """Agreement of skeletons in the picture that all have the same pose in space."""
    return landmarks.compare(np.stack(skeletons), np.stack([pose(seed)] * len(skeletons)))


@given(seed=seeds, x=st.floats(-6, 6), y=st.floats(-6, 6))
def test_residuals_point_to_the_landmarks_without_overshooting(
    seed: int, x: float, y: float
) -> None:
    (residuals,) = compared(shown(seed), seed, skeleton(seed) - (x, y)).residuals
    assert residuals.shape == (len(ROWS), 2)
    wanted = np.broadcast_to([x, y], residuals.shape)
    assert (residuals * wanted >= 0).all()
    assert (np.abs(residuals) <= np.abs(wanted) + 1e-12).all()
    # So near, they lead most of the way.
    assert_allclose(residuals, wanted, atol=0.4 * np.hypot(x, y) + 1e-9)


@given(seed=seeds, row=st.integers(0, len(ROWS) - 1))
def test_single_wrong_landmark_rules_no_skeleton_out(seed: int, row: int) -> None:
    right, wrong = shown(seed), shown(seed)
    wrong.positions[row] += 500
    there, here = (compared(one, seed, skeleton(seed)) for one in (right, wrong))
    lost = there.log_likelihood - here.log_likelihood
    assert 0 < lost[0] <= np.log((1 + OUTLIER_WEIGHT) / OUTLIER_WEIGHT) + 1e-9
    assert np.abs(here.residuals[0, row]).max() < 1e-3


@given(seed=seeds, other=seeds)
def test_exchanging_sides_negates_the_side_odds(seed: int, other: int) -> None:
    points, points_3d = skeleton(other), pose(other)
    agreement = shown(seed).compare(
        np.stack([points, exchange_sides(points)]), np.stack([points_3d, exchange_sides(points_3d)])
    )
    assert agreement.side_log_odds[0] == pytest.approx(-agreement.side_log_odds[1])
    assert agreement.log_likelihood[0] == pytest.approx(agreement.log_likelihood[1])


def test_agreement_shortens_distances_and_tilt_lengthens_them() -> None:
    agreement = Agreement(np.array([0.0, -8.0, 0.0, 0.0]), np.zeros(4), np.zeros((4, 1, 2)))
    fused = fused_distances(np.full(4, 2.0), agreement, np.array([0.0, 0.0, 90.0, -90.0]))
    assert fused[0] == 2
    assert (fused[1:] > 2).all()
    assert fused[2] == fused[3]


def apart(points: NDArray[np.float64], landmarks: NormalisedLandmarks) -> float:
    away = points[list(landmarks.rows)] - landmarks.positions
    return float(np.linalg.norm(away, axis=-1).mean())


@pytest.mark.parametrize("target", range(0, 576, 52))
def test_fit_keeps_bone_lengths_and_approaches_landmarks(toy_index: PoseIndex, target: int) -> None:
    """Poses that are found near landmarks, among them those that hardly fit."""
    entry = toy_index.entry(target)
    landmarks = landmarks_of(entry.points_normalised, entry.points_3d)
    points_3d, placed = toy_index.points(np.delete(np.arange(len(toy_index)), target))
    offsets = np.linalg.norm(landmarks.limb_offsets(points_3d), axis=-1).mean(axis=-1)
    near = np.argsort(offsets, kind="stable")[:60]
    points_3d, placed = points_3d[near], placed[near]
    fitted, fitted_placed = fit_to_landmarks(landmarks, points_3d, placed)
    assert fitted.shape == points_3d.shape and fitted_placed.shape == placed.shape
    assert_allclose(bone_lengths(fitted), bone_lengths(points_3d), rtol=1e-6)
    assert_allclose(fitted[:, 0], 0, atol=1e-12)
    # Left and right may be exchanged.
    before, after = (
        [min(apart(one, landmarks), apart(exchange_sides(one), landmarks)) for one in some]
        for some in (placed, fitted_placed)
    )
    assert np.mean(after) < 0.75 * np.mean(before)
    assert np.mean(np.array(after) <= np.array(before) + 0.5) > 0.95


def second(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The skeleton after another one, since the first follows the landmarks more than others."""
    return np.repeat(points, 2, axis=0)


def test_fit_follows_a_wrist_and_leaves_the_rest(toy_index: PoseIndex) -> None:
    points_3d, placed = (second(points) for points in toy_index.points(np.array([100])))
    wrist, elbow = rows("left_wrist", "left_elbow")
    seen = placed[1].copy()
    # Square to the forearm as it is seen, so that its length allows for it.
    forearm = seen[wrist] - seen[elbow]
    seen[wrist] += 6 * np.array([-forearm[1], forearm[0]]) / np.linalg.norm(forearm)
    fitted, fitted_placed = fit_to_landmarks(landmarks_of(seen, points_3d[1]), points_3d, placed)
    left = np.linalg.norm(fitted_placed[1, wrist] - seen[wrist])
    assert left < 2.5, f"expected the wrist to come from 6 px to under 2.5, got {left}"
    others = [row for row in range(JOINTS) if row not in (wrist, elbow)]
    assert np.linalg.norm(fitted_placed[1, others] - placed[1, others], axis=-1).max() < 2
    right_leg = rows("right_hip", "right_knee", "right_ankle", "right_toe")
    assert_allclose(fitted[1, right_leg], points_3d[1, right_leg], atol=1e-3)


def test_fit_recognises_exchanged_sides(toy_index: PoseIndex) -> None:
    """Landmarks that take left for right pull the other side's points, not across the body."""
    points_3d, placed = (second(points) for points in toy_index.points(np.array([100])))
    mistaken = landmarks_of(exchange_sides(placed[1]), exchange_sides(points_3d[1]))
    assert mistaken.compare(placed, points_3d).side_log_odds[1] < 0
    mistaken = replace(mistaken, limb_scores=np.zeros(len(LIMBS)))
    fitted, _ = fit_to_landmarks(mistaken, points_3d, placed)
    assert_allclose(fitted[1], points_3d[1], atol=1e-9)
