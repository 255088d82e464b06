"""Conventions of the skeleton and its camera, and the keypoint sets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from index.skeleton import (
    H36M17,
    JOINTS,
    KEYPOINT_SETS,
    NATIVE,
    POINT_NAMES,
    POINTS,
    KeypointSet,
    bone_lengths,
    camera_rotation,
    exchange_sides,
    mirror_3d,
    project,
    rotate_clockwise,
    rows,
    with_bone_lengths,
    wrap_degrees,
)

LEFT, UP, FRONT = np.eye(3)
angles = st.floats(-720, 720)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "roll", "direction", "seen"),
    [
        # In the face: the person's left at image right, up is -y, the nose comes nearer.
        (0, 0, 0, LEFT, (1, 0, 0)),
        (0, 0, 0, UP, (0, -1, 0)),
        (0, 0, 0, FRONT, (0, 0, -1)),
        # From the person's left: the left side is near, the nose points to image left.
        (90, 0, 0, LEFT, (0, 0, -1)),
        (90, 0, 0, FRONT, (-1, 0, 0)),
        # From behind: the person's left at image left.
        (180, 0, 0, LEFT, (-1, 0, 0)),
        (270, 0, 0, FRONT, (1, 0, 0)),
        # From straight above: the head is near, the nose points down the image.
        (0, 90, 0, UP, (0, 0, -1)),
        (0, 90, 0, FRONT, (0, 1, 0)),
        # A positive roll turns the picture clockwise: up goes to image right.
        (0, 0, 90, UP, (1, 0, 0)),
    ],
)
def test_camera_sees_body_axes(
    azimuth: float, elevation: float, roll: float, direction: np.ndarray, seen: tuple[float, ...]
) -> None:
    assert_allclose(camera_rotation(azimuth, elevation, roll) @ direction, seen, atol=1e-12)


@given(depth=st.floats(-0.9, 5), scale=st.floats(0.1, 10))
def test_projection_is_a_line_of_sight(depth: float, scale: float) -> None:
    # All points on a ray from the camera fall on the same place of the plane.
    ray = np.array([0.2, -0.1, 1.0])
    here, there = ray * (1 + depth), ray * (1 + depth) * scale
    camera = np.array([0.0, 0.0, 1.0])
    assert_allclose(
        project((here - camera)[None], 1.0), project((there - camera)[None], 1.0), atol=1e-9
    )


@pytest.mark.parametrize("keypoints", KEYPOINT_SETS.values(), ids=lambda k: k.name)
class TestKeypointSets:
    def test_indices_name_the_points(self, keypoints: KeypointSet) -> None:
        # Human3.6M names two points of the trunk otherwise.
        renamed = {"spine": "chest", "thorax": "neck"} if keypoints is H36M17 else {}
        names = tuple(renamed.get(name, name) for name in keypoints.names)
        assert tuple(POINT_NAMES[i] for i in keypoints.indices) == names

    def test_bones_connect_all_keypoints_once(self, keypoints: KeypointSet) -> None:
        assert len(set(keypoints.bones)) == len(keypoints.bones)
        # COCO draws its face apart from its trunk; every keypoint still has a bone.
        assert {end for bone in keypoints.bones for end in bone} == set(range(len(keypoints.names)))


def some_points(axes: int) -> np.ndarray:
    return np.random.default_rng(4).normal(size=(3, POINTS, axes))


class TestMirror:
    def test_left_becomes_right_and_the_middle_stays(self) -> None:
        points = some_points(3)[0]
        image = mirror_3d(points)
        left, right, nose = rows("left_wrist", "right_wrist", "nose")
        assert_array_equal(image[right], points[left] * (-1, 1, 1))
        assert_array_equal(image[left], points[right] * (-1, 1, 1))
        assert_array_equal(image[nose], points[nose] * (-1, 1, 1))

    @given(azimuth=angles, elevation=angles, roll=angles)
    def test_mirrored_body_before_the_mirrored_camera(
        self, azimuth: float, elevation: float, roll: float
    ) -> None:
        # A camera to a person's left becomes one to the right, and rolls the other way.
        body = some_points(3)[0]
        seen = body @ camera_rotation(azimuth, elevation, roll).T
        image = mirror_3d(body) @ camera_rotation(-azimuth, elevation, -roll).T
        assert_allclose(image, mirror_3d(seen), atol=1e-9)


def test_exchanging_sides_moves_names_not_points() -> None:
    points = np.random.default_rng(0).normal(size=(3, POINTS, 2))
    exchanged = exchange_sides(points)
    left, right, head = rows("left_knee", "right_knee", "head")
    assert_array_equal(exchanged[:, left], points[:, right])
    assert_array_equal(exchanged[:, head], points[:, head])
    assert_array_equal(exchange_sides(exchanged), points)


@given(angle=angles)
def test_wrapped_angles_are_the_same_angles(angle: float) -> None:
    wrapped = float(wrap_degrees(angle))
    assert -180 <= wrapped < 180
    assert np.cos(np.deg2rad(wrapped - angle)) == pytest.approx(1)


class TestRotateClockwise:
    def test_up_becomes_right_and_depth_stays(self) -> None:
        up = np.array([[0.0, -1.0, 0.3]])
        assert_allclose(rotate_clockwise(up, 90.0), [[1.0, 0.0, 0.3]], atol=1e-12)


@given(seed=st.integers(0, 999))
def test_bone_lengths_are_set_as_if_bone_by_bone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, lengths = rng.normal(size=(POINTS, 3)), rng.uniform(0.1, 1, len(NATIVE.bones))
    points -= points[0]
    expected, (head,) = points.copy(), rows("head")
    for (parent, child), length in zip(NATIVE.bones, lengths, strict=True):
        bone = points[child] - points[parent]
        expected[child] = expected[parent] + bone * length / np.linalg.norm(bone)
    expected[JOINTS:] += expected[head] - points[head]
    found = with_bone_lengths(points, lengths)
    assert_allclose(found, expected, atol=1e-12)
    assert_allclose(bone_lengths(found), lengths, atol=1e-12)
