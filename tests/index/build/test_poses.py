"""Which poses are taken: sound frames of the segments, mirrored, thinned by coverage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from index.build.body import Avatar, pose_transforms, posed_points, retarget
from index.build.motion import MotionError, Segment
from index.build.poses import Poses, farthest_points, joints_of, read_poses


def test_takes_the_frames_of_the_segments(poses: Poses) -> None:
    assert len(poses) == 30 + 18
    assert [clip.name for clip in poses.clips] == ["greet", "stroll"]
    assert poses.actions == ("walk", "wave")
    greeting = poses.clip == 0
    assert_array_equal(poses.frame[greeting], np.arange(2, 20))
    assert {poses.actions[a] for a in poses.action[greeting]} == {"wave"}


def test_refuses_no_segments(motion_folder: Path) -> None:
    with pytest.raises(MotionError, match="at least one segment"):
        read_poses(motion_folder, [])


def test_refuses_a_segment_beyond_its_clip(motion_folder: Path) -> None:
    with pytest.raises(MotionError, match="clip stroll ends at frame 31, the clip has 30"):
        read_poses(motion_folder, [Segment("stroll", "s1", "walk", 0, 31)])


def test_refuses_a_missing_clip(motion_folder: Path) -> None:
    with pytest.raises(MotionError, match="ghost"):
        read_poses(motion_folder, [Segment("ghost", "s1", "walk", 0, 3)])


def test_joints_of_equals_one_pose_at_a_time(poses: Poses, avatars: list[Avatar]) -> None:
    joints = joints_of(poses, avatars[1])
    for row in (0, 1, 30, 47):
        retargeting = retarget(poses.clips[poses.clip[row]], avatars[1])
        transforms = pose_transforms(avatars[1], retargeting, poses.rotations(row))
        assert_allclose(joints[row], posed_points(avatars[1], transforms)[0, :19], atol=1e-6)


@settings(max_examples=30)
@given(seed=st.integers(0, 999), points=st.integers(2, 40), count=st.integers(1, 12))
def test_farthest_points_cover(seed: int, points: int, count: int) -> None:
    features = np.random.default_rng(seed).normal(size=(points, 3))
    chosen = farthest_points(features, count)
    assert len(chosen) == len(set(chosen.tolist())) == min(count, points)
    apart = np.linalg.norm(features[:, None] - features[None], axis=-1)
    # Greedy: each is at least as far from those before it as any other row then was.
    for step in range(1, len(chosen)):
        nearest = apart[:, chosen[:step]].min(axis=1)
        assert nearest[chosen[step]] == pytest.approx(nearest.max(), abs=1e-3)
    # So the covering radius never exceeds the smallest gap between the chosen.
    if len(chosen) > 1:
        gaps = apart[np.ix_(chosen, chosen)] + np.eye(len(chosen)) * 99
        assert apart[:, chosen].min(axis=1).max() <= gaps.min() + 1e-3


def test_farthest_points_take_one_of_each_cluster() -> None:
    centres = np.array([[0, 0], [10, 0], [0, 10], [10, 10]])
    features = np.repeat(centres, 25, axis=0) + np.random.default_rng(0).normal(0, 0.1, (100, 2))
    assert {row // 25 for row in farthest_points(features, 4)} == {0, 1, 2, 3}
