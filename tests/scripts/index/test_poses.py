"""Which poses are taken: sound frames of the segments, mirrored, thinned by coverage."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.posture import POSTURES, classify_postures
from index.skeleton import JOINT_NAMES, NATIVE
from scripts.index.body import Avatar
from scripts.index.motion import Clip, MotionError, Segment
from scripts.index.poses import (
    TRUNK_BELOW_M,
    Poses,
    joints_of,
    laid_down,
    read_poses,
    side_of,
    with_level_heads,
)


def test_takes_the_frames_of_the_segments(poses: Poses) -> None:
    assert len(poses) == 30 + 18
    assert [clip.name for clip in poses.clips] == ["greet", "stroll"]
    assert poses.actions == ("walk", "wave")
    greeting = poses.clip == 0
    assert_array_equal(poses.frame[greeting], np.arange(2, 20))
    assert {poses.actions[a] for a in poses.action[greeting]} == {"wave"}


@pytest.mark.parametrize(
    ("segments", "said"),
    [
        ([], "at least one segment"),
        ([Segment("stroll", "s1", "walk", 0, 31)], "stroll ends at frame 31, the clip has 30"),
        ([Segment("ghost", "s1", "walk", 0, 3)], "ghost"),
    ],
)
def test_segments_that_are_not_there_are_refused(
    motion_folder: Path, segments: list[Segment], said: str
) -> None:
    with pytest.raises(MotionError, match=said):
        read_poses(motion_folder, segments)


UP = (0.0, 1.0, 0.0)


def lengths(joints: NDArray[np.floating]) -> NDArray[np.float64]:
    parents, children = (list(ends) for ends in zip(*NATIVE.bones, strict=True))
    return np.linalg.norm(joints[:, parents] - joints[:, children], axis=-1)


def standing(count: int) -> NDArray[np.float64]:
    """Rotations of two bones of bodies that stand, the second one bent."""
    bent = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return np.tile(np.stack([np.eye(3), bent]), (count, 1, 1, 1))


class TestLaidDown:
    @pytest.mark.parametrize(
        ("lying_deg", "side", "upward"),
        [
            (0.0, "back", (0, 0, 1)),  # the chest is up
            (90.0, "left", (-1, 0, 0)),  # the right side is up
            (180.0, "belly", (0, 0, -1)),
            (270.0, "right", (1, 0, 0)),
        ],
    )
    def test_lies_on_the_side_asked_for(
        self, lying_deg: float, side: str, upward: tuple[float, float, float]
    ) -> None:
        pelvis = laid_down(standing(1), np.array([lying_deg]))[0, 0]
        assert_allclose(pelvis @ upward, UP, atol=1e-12)
        assert side_of(lying_deg) == side


class TestLayDown:
    def test_the_same_bones_lie(self, poses: Poses, laid: Poses, avatars: list[Avatar]) -> None:
        joints = joints_of(laid, avatars[0])
        assert len(laid) > 20
        assert {POSTURES[row] for row in classify_postures(joints, UP)} == {"lying"}
        recorded = {
            (clip, frame): row
            for row, (clip, frame) in enumerate(zip(poses.clip, poses.frame, strict=True))
        }
        rows = [recorded[pair] for pair in zip(laid.clip, laid.frame, strict=True)]
        before = joints_of(poses, avatars[0])[rows]
        assert_allclose(lengths(joints), lengths(before), atol=1e-5)

    def test_trunks_rest_on_the_ground(self, laid: Poses, avatars: list[Avatar]) -> None:
        heights = joints_of(laid, avatars[0])[..., 1]
        heights -= heights.min(axis=1, keepdims=True)
        trunk = heights[:, [JOINT_NAMES.index(name) for name in ("pelvis", "chest")]]
        assert trunk.max() < TRUNK_BELOW_M


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
