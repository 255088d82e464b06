"""Which poses are taken: sound frames of the segments, mirrored, thinned by coverage."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.posture import POSTURES, classify_postures
from index.skeleton import NATIVE
from scripts.index.body import Avatar
from scripts.index.motion import Clip, MotionError, Segment
from scripts.index.poses import Poses, joints_of, laid_down, read_poses, side_of


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


@pytest.fixture
def clip(poses: Poses) -> Clip:
    return poses.clips[1]
