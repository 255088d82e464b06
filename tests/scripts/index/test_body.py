"""How poses move bodies: rotations, retargeting, skinned joints."""

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.skeleton import JOINT_NAMES
from scripts.index.body import (
    Avatar,
    facing_yaw,
    pose_transforms,
    posed_points,
    retarget,
    turned_to_front,
)
from scripts.index.motion import Clip, read_clip
from tests.scripts.index.toys import Angles, write_clip


def yaw_matrix(degrees: float) -> NDArray[np.float64]:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])


@given(degrees=st.floats(-360, 360))
def test_turned_to_front_faces_front_and_forgets_where_one_faced(degrees: float) -> None:
    rotations = np.stack([yaw_matrix(20), yaw_matrix(50)])[None]
    turned = turned_to_front(yaw_matrix(degrees) @ rotations)
    assert_allclose(facing_yaw(turned[:, 0]), 0, atol=1e-9)
    assert_allclose(turned, turned_to_front(rotations), atol=1e-9)
    # Bones keep their angles to each other.
    assert_allclose(turned[0, 1], yaw_matrix(30), atol=1e-9)


def points_by_name(avatar: Avatar, clip: Clip, frame: int = 0) -> dict[str, NDArray[np.float64]]:
    transforms = pose_transforms(avatar, retarget(clip, avatar), clip.rotations[frame][None])
    points = posed_points(avatar, transforms)[0, : len(JOINT_NAMES)]
    return dict(zip(JOINT_NAMES, points, strict=True))


def test_limbs_point_where_the_motion_says(tmp_path: Path, avatars: list[Avatar]) -> None:
    # The left arm raised to the vertical, the right forearm bent forward at the elbow.
    frame: Angles = {"LeftArm": (90.0, 0.0, 0.0), "RightForeArm": (0.0, 90.0, 0.0)}
    clip = read_clip(write_clip(tmp_path / "signal.bvh", [frame, frame]))
    joints = points_by_name(avatars[0], clip)
    up = joints["left_wrist"] - joints["left_shoulder"]
    assert_allclose(up / np.linalg.norm(up), (0, 1, 0), atol=1e-6)
    forward = joints["right_wrist"] - joints["right_elbow"]
    assert_allclose(forward / np.linalg.norm(forward), (0, 0, 1), atol=1e-6)
