"""Skeletons placed before the camera, in perspective."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.estimation.poses import place_skeletons
from app.vision.optics import PinholeCamera, to_line_of_sight
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.skeleton import POINT_NAMES, mirror_3d, side_rows
from tests.conftest import stick_figure

CAMERA = PinholeCamera.of_frame((720, 1280), 70.0)
HIPS = side_rows("hip")


def skeleton(seed: int = 0) -> NDArray[np.float64]:
    """A pose ``(24, 3)`` in axes of a line of sight: y down, away from the camera."""
    return stick_figure(np.random.default_rng(seed)) * [1.0, -1.0, -1.0]


def seen(
    pose: NDArray[np.float64], pelvis: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The pose ``(24, 3)`` in camera axes about the hips' line of sight, and its pixels."""
    line = to_line_of_sight(pelvis)
    placed = pose @ line + pelvis
    return placed, CAMERA.project(placed)


def landmarks_of(placed: NDArray[np.float64], visibility: float = 0.9) -> Landmarks:
    """Exact landmarks of a placed skeleton; those that it lacks lie at the nose."""
    rows = [
        POINT_NAMES.index(name.replace("foot_index", "toe"))
        if name.replace("foot_index", "toe") in POINT_NAMES
        else POINT_NAMES.index("nose")
        for name in LANDMARK_NAMES
    ]
    hips = placed[HIPS].mean(axis=0)
    pixels = CAMERA.project(placed[rows])
    landmark_hips = side_rows("hip", among=LANDMARK_NAMES)
    line = to_line_of_sight(CAMERA.rays(pixels[landmark_hips].mean(axis=0)))
    metres = (placed[rows] - hips) @ line.T
    count = len(LANDMARK_NAMES)
    return Landmarks(pixels, np.full(count, visibility), metres, np.full(count, 1e-3))


@given(x=st.floats(-2, 2), y=st.floats(-0.5, 0.5), z=st.floats(3, 8))
def test_exact_skeletons_stay_where_they_are(x: float, y: float, z: float) -> None:
    placed, pixels = seen(skeleton(), np.array([x, y, z]))
    line = to_line_of_sight(placed[HIPS].mean(axis=0))
    own = (placed - placed[HIPS].mean(axis=0)) @ line.T
    result = place_skeletons(own[None], pixels[None], landmarks_of(placed), CAMERA)
    assert_allclose(result.points_2d[0], pixels, atol=1e-6)
    assert_allclose(result.points_3d[0] + result.pelvis[0], placed, atol=0.03)


def test_first_hypothesis_follows_the_landmarks_in_depth_and_the_second_does_not() -> None:
    placed, pixels = seen(skeleton(1), np.array([0.5, 0.0, 4.0]))
    own = (placed - placed[HIPS].mean(axis=0)) @ to_line_of_sight(placed[HIPS].mean(axis=0)).T
    twin = own * [1.0, 1.0, -1.0]
    result = place_skeletons(
        np.array([twin, twin]), np.array([pixels, pixels]), landmarks_of(placed), CAMERA
    )
    limbs = side_rows("wrist") + side_rows("ankle")
    errors = np.linalg.norm(
        result.points_3d[:, limbs] + result.pelvis[:, None] - placed[limbs], axis=-1
    ).mean(axis=1)
    assert errors[0] < 0.5 * errors[1]


def test_joints_project_to_their_pixels() -> None:
    placed, pixels = seen(skeleton(2), np.array([-1.0, 0.3, 5.0]))
    poses = np.array([skeleton(3), mirror_3d(skeleton(4))])
    result = place_skeletons(poses, np.array([pixels, pixels]), landmarks_of(placed), CAMERA)
    again = CAMERA.project(result.points_3d + result.pelvis[:, None])
    assert_allclose(again, result.points_2d, atol=1e-6)


def test_without_landmarks_a_known_field_of_view_turns_the_skeleton() -> None:
    pose = skeleton(5) - skeleton(5)[POINT_NAMES.index("pelvis")]
    _, pixels = seen(pose, np.array([2.0, 0.0, 4.0]))
    assumed = PinholeCamera(CAMERA.focal, CAMERA.centre)
    kept = place_skeletons(pose[None], pixels[None], None, assumed)
    turned = place_skeletons(pose[None], pixels[None], None, CAMERA)
    assert_allclose(kept.points_3d[0], pose)
    rotation = to_line_of_sight(CAMERA.rays(pixels[POINT_NAMES.index("pelvis")]))
    assert_allclose(turned.points_3d[0], pose @ rotation, atol=1e-9)
    assert turned.pelvis[0, 2] == pytest.approx(4.0, abs=0.1)
