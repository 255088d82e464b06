"""Heads held level, and nothing else moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.build.motion import Clip
from index.build.parameters import POSES
from index.build.poses import Poses, with_level_heads
from index.skeleton import JOINT_NAMES

HEAD = JOINT_NAMES.index("head")


def about(axis: int, degrees: NDArray[np.floating] | float) -> NDArray[np.float64]:
    """Rotations ``(..., 3, 3)`` about an axis; about x (0), positive pitches the face down."""
    angle = np.deg2rad(np.asarray(degrees, np.float64))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angle)
    matrix[..., first, second], matrix[..., second, first] = -np.sin(angle), np.sin(angle)
    return matrix


def hanging(clip: Clip, degrees: float, frames: int = 200, seed: int = 0) -> Clip:
    """The clip's first frame, repeated; the head hangs by ``degrees`` and is turned about."""
    rng = np.random.default_rng(seed)
    rotations = np.repeat(clip.rotations[:1], frames, axis=0)
    head = about(1, rng.normal(0, 20, frames)) @ about(0, degrees + rng.normal(0, 8, frames))
    rotations[:, clip.bones.index("Spine1")] = np.eye(3)
    rotations[:, clip.bones.index("Head")] = head
    still = np.zeros(frames)
    return replace(clip, rotations=rotations, speeds=still, broken=still.astype(bool))


def pitches_deg(clip: Clip) -> NDArray[np.float64]:
    """How far the face looks up in every frame."""
    forward = clip.rotations[:, clip.bones.index("Head"), :, 2]
    return np.rad2deg(np.arcsin(forward[:, 1]))


@pytest.fixture
def clip(poses: Poses) -> Clip:
    return poses.clips[1]


@pytest.mark.parametrize("degrees", [-15.0, 0.0, 20.0, 40.0])
def test_each_subject_looks_ahead_in_the_median(clip: Clip, degrees: float) -> None:
    clips = [hanging(clip, degrees, seed=seed) for seed in (0, 1)] + [hanging(clip, 10.0, seed=2)]
    *both, other = with_level_heads(clips, ["a", "a", "b"])
    assert np.median(np.concatenate([pitches_deg(one) for one in both])) == pytest.approx(
        0, abs=0.5
    )
    assert np.median(pitches_deg(other)) == pytest.approx(0, abs=0.5)


def test_how_heads_nod_and_where_they_look_stays(clip: Clip) -> None:
    before = hanging(clip, 25.0)
    (after,) = with_level_heads([before], ["a"])
    pitch = np.median(pitches_deg(before))
    assert pitch == pytest.approx(-25, abs=2)
    assert_allclose(pitches_deg(after), pitches_deg(before) - pitch, atol=1e-6)
    left = [one.rotations[:, one.bones.index("Head"), :, 0] for one in (before, after)]
    assert_allclose(*left, atol=1e-12)


def test_only_the_head_moves(clip: Clip) -> None:
    before = hanging(clip, 25.0)
    (after,) = with_level_heads([before], ["a"])
    others = [bone for bone, name in enumerate(clip.bones) if name != "Head"]
    assert_array_equal(after.rotations[:, others], before.rotations[:, others])
    head = after.rotations[:, clip.bones.index("Head")]
    assert_allclose(head @ head.swapaxes(1, 2), np.broadcast_to(np.eye(3), head.shape), atol=1e-12)
    assert_allclose(np.linalg.det(head), 1)


def test_frames_that_are_not_upright_or_broken_do_not_count(clip: Clip) -> None:
    before = hanging(clip, 20.0, frames=300)
    rotations, broken = before.rotations.copy(), before.broken.copy()
    head, spine = (clip.bones.index(name) for name in ("Head", "Spine1"))
    rotations[100:200, head] = rotations[200:, head] = about(0, -80.0)
    rotations[100:200, spine] = about(0, 60.0)
    broken[200:] = True
    (after,) = with_level_heads([replace(before, rotations=rotations, broken=broken)], ["a"])
    assert np.median(pitches_deg(after)[:100]) == pytest.approx(0, abs=1e-6)


def test_who_is_hardly_seen_upright_is_corrected_as_the_others_are(clip: Clip) -> None:
    clips = [hanging(clip, degrees, seed=seed) for seed, degrees in enumerate((10.0, 20.0, 60.0))]
    rare = hanging(clip, 50.0, frames=POSES.min_upright_frames - 1, seed=4)
    usual = np.median([np.median(pitches_deg(one)) for one in clips])
    *_, after = with_level_heads([*clips, rare], ["a", "b", "c", "d"])
    assert_allclose(pitches_deg(after), pitches_deg(rare) - usual, atol=1e-6)


def test_without_enough_upright_frames_nothing_moves(clip: Clip) -> None:
    rare = hanging(clip, 50.0, frames=POSES.min_upright_frames - 1)
    (after,) = with_level_heads([rare], ["a"])
    assert_array_equal(after.rotations, rare.rotations)
