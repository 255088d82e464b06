"""Poses laid on the ground: the same bodies, turned as a whole, and lying."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.build.body import Avatar, facing_yaw
from index.build.parameters import POSES
from index.build.poses import SIDES, Poses, joints_of, laid_down, lay_down, side_of
from index.posture import POSTURES, classify_postures
from index.skeleton import JOINT_NAMES, NATIVE

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

    def test_the_long_axis_is_level_and_the_pelvis_faces_ahead(self) -> None:
        angles = np.linspace(0, 360, 24, endpoint=False) + 3.0
        laid = laid_down(standing(len(angles)), angles)
        assert_allclose(laid[:, 0, 1, 1], 0, atol=1e-12)
        assert_allclose(facing_yaw(laid[:, 0]), 0, atol=1e-9)

    def test_limbs_are_held_as_recorded(self) -> None:
        angles = np.arange(0.0, 360.0, 30.0)
        recorded = standing(len(angles))
        laid = laid_down(recorded, angles)
        relative = [bones[:, 0].swapaxes(1, 2) @ bones[:, 1] for bones in (recorded, laid)]
        assert_allclose(*relative, atol=1e-12)


@pytest.mark.parametrize("turn", [-360.0, 0.0, 360.0])
@pytest.mark.parametrize("off", [-44.0, 0.0, 44.0])
def test_sides_by_quarters(turn: float, off: float) -> None:
    assert [side_of(quarter + off + turn) for quarter in (0, 90, 180, 270)] == list(SIDES)


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
        assert trunk.max() < POSES.trunk_below_m

    def test_same_seed_same_poses(self, poses: Poses, laid: Poses, avatars: list[Avatar]) -> None:
        again = lay_down(poses, avatars[0], len(poses), seed=0)
        assert_array_equal(again.lying_deg, laid.lying_deg)
        assert_array_equal(again.frame, laid.frame)
        other = lay_down(poses, avatars[0], len(poses), seed=1)
        assert not set(other.lying_deg) & set(laid.lying_deg)

    def test_tries_no_more_than_asked(self, poses: Poses, avatars: list[Avatar]) -> None:
        few = lay_down(poses, avatars[0], 10, seed=3)
        assert 0 < len(few) <= 10
        assert len(lay_down(poses, avatars[0], 0, seed=3)) == 0
