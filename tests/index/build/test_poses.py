"""Which poses are taken: sound frames of the segments, mirrored, thinned by coverage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from index.build.motion import MotionError, Segment
from index.build.poses import Poses, farthest_points, merged, read_poses
from tests.index.toys import walk, write_clip


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


def test_heads_of_whole_subjects_are_held_level(tmp_path: Path) -> None:
    hanging = [{**frame, "Head": (0.0, 0.0, 15.0)} for frame in walk(60)]
    for name in ("one", "two"):
        write_clip(tmp_path / "bvh" / f"{name}.bvh", hanging)
    segments = [Segment(name, "s1", "walk", 0, 60) for name in ("one", "two")]
    poses, _ = read_poses(tmp_path, segments)
    forward = [clip.rotations[:, clip.bones.index("Head"), 1, 2] for clip in poses.clips]
    assert np.median(forward) == pytest.approx(0, abs=1e-6)


def test_speeds_are_those_of_the_clips_but_for_who_lies(poses: Poses) -> None:
    clips = tuple(
        replace(clip, speeds=number + np.arange(len(clip.rotations)) / 100)
        for number, clip in enumerate(poses.clips)
    )
    lying_deg = np.where(np.arange(len(poses)) % 3 == 0, 90.0, np.nan)
    speeds = replace(poses, clips=clips, lying_deg=lying_deg).speeds()
    assert_allclose(speeds, np.where(np.isnan(lying_deg), poses.clip + poses.frame / 100, 0))


def test_merged_holds_all_parts_in_order_and_names_their_actions(poses: Poses, laid: Poses) -> None:
    for parts in ([laid, poses], [poses, laid], [poses.take(np.arange(0)), laid]):
        together = merged(parts)
        assert len(together) == sum(map(len, parts))
        start = 0
        for part in parts:
            rows = np.arange(start, start + len(part))
            same = together.take(rows)
            for name in ("clip", "frame", "lying_deg"):
                assert_array_equal(getattr(same, name), getattr(part, name))
            assert [together.actions[a] for a in same.action] == [
                part.actions[a] for a in part.action
            ]
            start += len(part)


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
