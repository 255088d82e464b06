"""Conventions of the skeleton and its camera, and the keypoint sets."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from index.skeleton import (
    POINTS,
    camera_rotation,
    exchange_sides,
    mirror_3d,
    project,
    rotate_clockwise,
    rows,
)

angles = st.floats(-720, 720)


@given(depth=st.floats(-0.9, 5), scale=st.floats(0.1, 10))
def test_projection_is_a_line_of_sight(depth: float, scale: float) -> None:
    # All points on a ray from the camera fall on the same place of the plane.
    ray = np.array([0.2, -0.1, 1.0])
    here, there = ray * (1 + depth), ray * (1 + depth) * scale
    camera = np.array([0.0, 0.0, 1.0])
    assert_allclose(
        project((here - camera)[None], 1.0), project((there - camera)[None], 1.0), atol=1e-9
    )


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


class TestRotateClockwise:
    def test_up_becomes_right_and_depth_stays(self) -> None:
        up = np.array([[0.0, -1.0, 0.3]])
        assert_allclose(rotate_clockwise(up, 90.0), [[1.0, 0.0, 0.3]], atol=1e-12)
