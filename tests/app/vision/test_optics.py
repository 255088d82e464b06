"""Lines of sight: rotations, placing bodies, cameras of frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from app.vision.optics import PinholeCamera, place_on_sight_lines, roll_rotation, to_line_of_sight
from tests.support.projection import project

SHAPE = (720, 1280, 3)
directions = st.tuples(st.floats(-2, 2), st.floats(-2, 2)).map(lambda xy: np.array([*xy, 1.0]))


@given(directions)
def test_a_line_of_sight_becomes_the_z_axis(ray: np.ndarray) -> None:
    rotation = to_line_of_sight(ray)
    assert_allclose(rotation @ ray, [0, 0, np.linalg.norm(ray)], atol=1e-9)
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
    # The smallest rotation: what is across both directions stays.
    axis = np.cross(ray, [0, 0, 1])
    assert_allclose(rotation @ axis, axis, atol=1e-9)


@given(st.floats(20, 120), directions)
def test_projecting_undoes_a_ray(fov_deg: float, point: np.ndarray) -> None:
    camera = PinholeCamera.of_frame(SHAPE, fov_deg)
    ray = camera.rays(project(camera, 3 * point))
    assert_allclose(ray, point, atol=1e-9)


def test_sixty_degrees_are_assumed_along_the_longer_side() -> None:
    wide, high = PinholeCamera.of_frame((720, 1280)), PinholeCamera.of_frame((1280, 720))
    assert_allclose(wide.focal, high.focal)
    assert wide.focal[0] == pytest.approx(640 / np.tan(np.deg2rad(30)))


@pytest.mark.parametrize("fov_deg", [0.0, 180.0, -3.0, 400.0, float("nan")])
def test_impossible_fields_of_view_are_refused(fov_deg: float) -> None:
    with pytest.raises(ValueError, match="field of view between 0 and 180"):
        PinholeCamera.of_frame(SHAPE, fov_deg)


@given(
    st.integers(0, 10_000), st.floats(1.5, 9.0), st.floats(-0.9, 0.9), st.floats(-0.6, 0.6),
    st.floats(-180, 180),
)  # fmt: skip
def test_a_true_body_is_placed_where_it_is(
    seed: int, distance: float, x: float, y: float, roll: float
) -> None:
    body = np.random.default_rng(seed).normal(0, [0.25, 0.45, 0.25], (33, 3)).clip(-0.9, 0.9)
    hips = distance * np.array([x, y, 1.0])
    camera = PinholeCamera.of_frame(SHAPE, 70)
    places = project(camera, body + hips)
    axes = roll_rotation(roll) @ to_line_of_sight(hips)
    placed = place_on_sight_lines(body @ axes.T, camera.rays(places), axes, np.ones(33))
    assert_allclose(placed.points, body + hips, atol=1e-4)
    assert_allclose(placed.origin, hips, atol=1e-4)
