"""Modes: apart from each other, and interpolated to the query."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.candidates import Candidates, RotatedQuery, find_candidates
from index.modes import DISTINCT_M, DepthModes, Modes, candidate_weights, depth_modes, find_modes
from index.skeleton import JOINTS, LIMBS, POINTS, bone_lengths, rows
from index.store import PoseIndex
from tests.index.helpers import landmarks_of

Points = NDArray[np.float64]


def candidates_of(
    query: NDArray[np.floating], vectors: NDArray[np.floating], poses: Points
) -> Candidates:
    """Made-up candidates, brought into the order of their distance."""
    distances = np.linalg.norm(vectors - query, axis=1)
    order = np.argsort(distances, kind="stable")
    return Candidates(
        order,
        np.zeros(len(order), bool),
        distances[order],
        (vectors[order] - query).astype(np.float32),
        np.zeros(len(order)),
        poses[order],
        100 * poses[order, :, :2],
    )


def some_pose(seed: int = 0) -> Points:
    """Points half a metre about the pelvis, which is the origin."""
    pose = np.random.default_rng(seed).normal(0, 0.3, (POINTS, 3))
    pose[0] = 0
    return pose


def modes_of(candidates: Candidates, count: int, **options: Any) -> Modes:
    """Modes by the distances of the candidates alone."""
    weights = candidate_weights(candidates.distances)
    return find_modes(candidates, weights, count, candidates.offsets, **options)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 999),
    size=st.integers(1, 60),
    count=st.integers(1, 20),
    spread=st.sampled_from([0.0, 0.01, 0.1, 1.0]),
)
def test_modes_are_distinct_and_keep_bone_lengths(
    seed: int, size: int, count: int, spread: float
) -> None:
    rng = np.random.default_rng(seed)
    poses = some_pose() + spread * rng.normal(size=(size, POINTS, 3))
    found = candidates_of(rng.normal(size=6), rng.normal(size=(size, 6)), poses)
    modes = modes_of(found, count)
    assert 1 <= len(modes) <= count
    centres = found.points_3d[modes.centres, :JOINTS]
    apart = np.sqrt(((centres[:, None] - centres[None]) ** 2).sum(axis=-1).mean(axis=-1))
    assert (apart[~np.eye(len(modes), dtype=bool)] >= DISTINCT_M - 1e-6).all()
    if len(modes) < count and spread in (0.0, 1.0):
        # None was left out: every candidate is near some centre.
        joints = found.points_3d[:, None, :JOINTS]
        nearest = np.sqrt(((joints - centres) ** 2).sum(axis=-1).mean(axis=-1)).min(axis=1)
        assert (nearest < DISTINCT_M + 1e-6).all()
    assert (modes.distances >= 0).all()
    assert modes.points_3d.shape == (len(modes), POINTS, 3)
    for numbers in (modes.distances, modes.points_3d, modes.points_normalised):
        assert np.isfinite(numbers).all()
    centre_lengths = bone_lengths(found.points_3d[modes.centres])
    assert_allclose(bone_lengths(modes.points_3d), centre_lengths, rtol=1e-6)


def test_denser_mode_comes_first() -> None:
    poses = np.stack([some_pose(1)] * 3 + [some_pose(2)] * 7)
    angles = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)  # all as near
    modes = modes_of(candidates_of(np.zeros(2), ring, poses), 5)
    assert len(modes) == 2
    assert_allclose(modes.points_3d[0], some_pose(2), atol=1e-3)


@pytest.mark.parametrize("where", [0.35, 0.45, 0.5, 0.6])
def test_query_between_known_poses_is_interpolated(where: float) -> None:
    """Pose and descriptor both move along a line with eleven known points."""
    start = some_pose()
    step = np.zeros((POINTS, 3))
    wrist, elbow = rows("left_wrist", "left_elbow")
    # Square to its bone, so that the bone hardly changes its length.
    step[wrist] = np.cross(start[wrist] - start[elbow], [0, 0, 1])
    step *= 0.2 / np.linalg.norm(step)
    along, direction = np.linspace(0, 1, 11), np.array([3.0, -4.0, 0.0])
    poses = start + along[:, None, None] * step
    found = candidates_of(where * direction, along[:, None] * direction, poses)
    modes = modes_of(found, 3)
    assert len(modes) == 1
    reached = ((modes.points_normalised[0] - 100 * start[:, :2]) * step[:, :2]).sum()
    reached /= 100 * (step[:, :2] ** 2).sum()
    # Half a step between neighbours: the regression must do better than taking the nearest.
    assert reached == pytest.approx(where, abs=0.05)
    assert modes.distances[0] < 0.05 * np.linalg.norm(direction)
    assert_allclose(modes.points_3d[0, wrist], (start + where * step)[wrist], atol=0.02)


def nearest(index: PoseIndex, silhouette: NDArray[np.uint8]) -> Candidates:
    return find_candidates(index, [RotatedQuery.of(silhouette, 0.0)], 200)


def test_rounding_does_not_choose_among_equal_densities() -> None:
    rng = np.random.default_rng(0)
    # One pose, tilted by a hair: the sums of its kernels differ by rounding alone.
    poses = np.tile(some_pose(), (40, 1, 1)) * (1 + 1e-15 * rng.normal(size=(40, 1, 1)))
    ring = np.stack([np.cos(np.arange(40.0)), np.sin(np.arange(40.0))], axis=1)
    found = replace(candidates_of(np.zeros(2), ring, poses), distances=np.ones(40))
    assert modes_of(found, 1).centres.tolist() == [0]


# Errors in depth that go together: the upper body leans, with a standard deviation of 15 cm.
LEAN = np.array([0.15] * 6 + [0.0] * 6)


def depths_about(seed: int, covariance: Points) -> DepthModes:
    """Alternatives to the depths of a pose among candidates that scatter about it."""
    rng = np.random.default_rng(seed)
    pose = some_pose(seed)
    poses = pose + rng.normal(0, 0.1, (60, POINTS, 3))
    found = candidates_of(rng.normal(size=6), rng.normal(size=(60, 6)), poses)
    landmarks = replace(landmarks_of(100 * pose[:, :2], pose), limb_covariance=covariance)
    agreement = landmarks.compare(found.points_normalised, found.points_3d)
    return depth_modes(found, landmarks, agreement)


@pytest.mark.parametrize("seed", range(4))
def test_alternatives_in_depth_spread_over_what_is_uncertain(seed: int) -> None:
    found = depths_about(seed, np.outer(LEAN, LEAN))
    along = found.offsets @ LEAN / (LEAN @ LEAN)  # In standard deviations.
    assert along.min() < -0.5 and along.max() > 0.5
    assert np.abs(found.offsets - along[:, None] * LEAN).max() < 0.02
    assert np.diff(np.sort(along)).min() > 0.1
    assert ((found.nearer > 0) & (found.nearer < 1)).all()
    assert (found.misfits > along**2 / 2 - 0.05).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_share_nearer_to_an_alternative_is_that_of_the_posterior(seed: int) -> None:
    """Candidates at the landmarks: the posterior is normal about these, with a known covariance."""
    pose = some_pose(seed)
    found = candidates_of(np.zeros(6), np.ones((9, 6)), np.tile(pose, (9, 1, 1)))
    errors = 0.03 * np.eye(len(LIMBS)) + np.outer(LEAN, LEAN)
    landmarks = replace(landmarks_of(100 * pose[:, :2], pose), limb_covariance=errors)
    agreement = landmarks.compare(found.points_normalised, found.points_3d)
    depths = depth_modes(found, landmarks, agreement)
    covariance = np.linalg.inv(np.linalg.inv(errors) + np.eye(len(LIMBS)) / 0.2**2)
    truths = np.random.default_rng(seed).multivariate_normal(np.zeros(12), covariance, 20_000)
    apart = np.linalg.norm(truths[:, None] - depths.offsets, axis=-1)
    nearer = (apart < np.linalg.norm(truths, axis=-1)[:, None]).mean(axis=0)
    assert_allclose(depths.nearer, nearer, atol=0.02)
    along = depths.offsets @ np.linalg.solve(errors, depths.offsets.T)
    assert_allclose(depths.misfits, np.diag(along) / 2, rtol=1e-3)
