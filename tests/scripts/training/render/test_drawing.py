"""Meshes, the rasteriser, rooms, cameras and development: what a picture must hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("numba")

from scripts.training.render import furniture
from scripts.training.render.cameras import aimed_at, sample_camera
from scripts.training.render.development import develop
from scripts.training.render.materials import Material, Materials, cloth, surface
from scripts.training.render.meshes import box, ellipsoid, joined, sheet, tube, wheel
from scripts.training.render.raster import NOTHING, rasterise, shadow_map, vertex_normals
from scripts.training.render.rooms import build_room

SEEDS = st.integers(0, 1000)


def test_normals_of_a_ball_point_outward_or_inward_alike() -> None:
    ball = ellipsoid([0, 0, 0], [1, 1, 1], 0, 20)
    normals = vertex_normals(ball.vertices, ball.triangles)
    # Poles and the seam share their place among vertices.
    inner = slice(2 * 20, -2 * 20)
    along = (normals[inner] * ball.vertices[inner]).sum(axis=1)
    assert (np.abs(along) > 0.9).all() and len(set(np.sign(along))) == 1


def test_joined_meshes_keep_their_triangles() -> None:
    parts = [box([0, 0, 0], [1, 2, 3], 4), tube([0, 0, 0], [0, 1, 0], 0.1, 5)]
    whole = joined(parts)
    assert len(whole.triangles) == sum(len(part.triangles) for part in parts)
    second = whole.triangles[len(parts[0].triangles) :]
    assert_array_equal(whole.vertices[second], parts[1].vertices[parts[1].triangles])
    assert_array_equal(whole.materials[second], 5)


def test_a_box_spans_its_corners() -> None:
    one = box([-1, 0, 2], [1, 2, 3], 0)
    assert_allclose(one.vertices.min(axis=0), [-1, 0, 2])
    assert_allclose(one.vertices.max(axis=0), [1, 2, 3])


@given(SEEDS)
def test_bodies_of_all_kinds_are_finite(seed: int) -> None:
    generator, materials = np.random.default_rng(seed), Materials()
    makers = furniture.SUBJECTS + furniture.CLUTTER
    mesh = makers[seed % len(makers)](materials, generator)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.triangles.max() < len(mesh.vertices)
    assert mesh.materials.max() < len(materials.rows)
    assert mesh.vertices[:, 1].min() > -0.7 and np.abs(mesh.vertices).max() < 4
    wheel_at = wheel([0, 0.3, 0], [1, 0, 0], 0.3, 0.02, 0)
    assert np.isfinite(wheel_at.vertices).all()


@given(SEEDS)
def test_a_blanket_over_the_lap_covers_the_legs_but_not_the_trunk(seed: int) -> None:
    generator, materials = np.random.default_rng(seed), Materials()
    thighs = ellipsoid([0, 0.5, 0.25], [0.2, 0.08, 0.25], 0)
    trunk = ellipsoid([0, 0.9, 0], [0.2, 0.35, 0.12], 0)
    body = joined([thighs, trunk]).vertices
    [blanket] = furniture.lap_blanket(body, 0.0, 0.48, materials, generator)
    cloth = blanket.vertices
    over_the_knees = cloth[(np.abs(cloth[:, 0]) < 0.05) & (np.abs(cloth[:, 2] - 0.3) < 0.05)]
    assert over_the_knees[:, 1].min() > 0.5
    assert cloth[:, 1].max() < 0.9 and cloth[:, 2].min() > 0


def test_a_helmet_holds_the_ears() -> None:
    ears = np.array([0.1, 1.6, 0.05])
    shell = furniture.helmet(ears, Materials(), np.random.default_rng(0)).vertices
    assert (shell.min(axis=0) < ears).all() and (shell.max(axis=0) > ears).all()


def test_the_nearer_triangle_is_shown() -> None:
    plane = np.array([[0, 0], [20, 0], [0, 20]] * 2, np.float32)
    depths = np.array([2, 2, 2, 1, 1, 3], np.float32)
    triangles = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    nearness, shares = np.zeros((20, 20), np.float32), np.zeros((20, 20, 2), np.float32)
    shown = np.full((20, 20), NOTHING, np.int32)
    rasterise(plane, depths, triangles, 0.1, nearness, shown, shares)
    assert shown[0, 5] == 1 and shown[18, 0] == 0 and shown[19, 19] == NOTHING
    assert nearness[18, 0] == pytest.approx(0.5)
    # In perspective: one over depth is linear in the picture.
    share = 1 - 5 / 20
    assert nearness[5, 0] == pytest.approx(share + (1 - share) / 3, rel=1e-3)


def test_triangles_behind_the_camera_are_left_out() -> None:
    plane = np.array([[0, 0], [20, 0], [0, 20]], np.float32)
    nearness, shares = np.zeros((20, 20), np.float32), np.zeros((20, 20, 2), np.float32)
    shown = np.full((20, 20), NOTHING, np.int32)
    depths = np.array([1, -1, 1], np.float32)
    rasterise(plane, depths, np.array([[0, 1, 2]], np.int32), 0.1, nearness, shown, shares)
    assert (shown == NOTHING).all()


def test_shadow_maps_hold_what_is_nearest_to_the_light() -> None:
    points = np.array([[0, 0, 1], [30, 0, 1], [0, 30, 1], [0, 0, 2], [9, 0, 2], [0, 9, 2]])
    heights = np.full((32, 32), -1e9, np.float32)
    triangles = np.arange(6).reshape(2, 3).astype(np.int32)
    shadow_map(points.astype(np.float32), triangles, heights)
    assert heights[1, 1] == 2 and heights[10, 10] == 1 and heights[31, 31] < 0


@given(SEEDS, st.floats(-0.6, 0.6), st.floats(-0.5, 0.5))
def test_cameras_show_their_target_about_where_it_is_wanted(seed: int, x: float, y: float) -> None:
    direction = np.random.default_rng(seed).normal(size=3) * [1, 0.1, 1] + 1e-3
    if np.hypot(direction[0], direction[2]) < 0.3:
        return
    seen = aimed_at(direction, np.array([x, y]), 0.0) @ direction
    assert seen[2] > 0
    assert_allclose(seen[:2] / seen[2], [x, y], atol=0.35)
    straight = aimed_at(direction, np.zeros(2), 0.3) @ direction
    assert_allclose(straight[:2] / straight[2], 0, atol=1e-9)


@given(SEEDS)
def test_cameras_are_rotations_that_look_at_a_target(seed: int) -> None:
    target = np.array([0.3, 0.9, -0.2])
    camera = sample_camera(target, 0.0, np.random.default_rng(seed), close=seed % 2 == 0)
    assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(camera.rotation) == pytest.approx(1)
    assert camera.place[1] > 0
    # Of frames that stand, the longer side is as wide as others are across.
    widest = np.rad2deg(2 * np.arctan(1 / camera.focal))
    assert 39.9 < widest < 110.1 and camera.fov_deg <= widest + 1e-9
    # A camera below its target has a negative elevation.
    above = np.deg2rad(camera.elevation_deg(target))
    apart = np.linalg.norm(camera.place - target)
    assert camera.place[1] - target[1] == pytest.approx(apart * np.sin(above))


@given(SEEDS)
def test_rooms_hold_who_is_in_them(seed: int) -> None:
    places = np.random.default_rng(seed).uniform([-2, 0.5, -2], [2, 4.5, 2], (3, 3))
    room = build_room(places, 0.2, np.random.default_rng(seed))
    inside = places @ room.turn.T
    assert (inside > room.corners[0]).all() and (inside < room.corners[1]).all()
    assert room.corners[0, 1] == pytest.approx(0.2)
    assert room.materials.shape == (6, 12) and room.panels.shape[1] == 18


@given(SEEDS)
def test_pictures_are_developed_to_their_size(seed: int) -> None:
    light = np.random.default_rng(0).uniform(0, 2, (40, 60, 3)).astype(np.float32)
    image = develop(light, (30, 20), np.random.default_rng(seed))
    assert image.shape == (20, 30, 3) and image.dtype == np.uint8
    assert_array_equal(image, develop(light, (30, 20), np.random.default_rng(seed)))


def test_materials_are_rows_of_a_table() -> None:
    materials, generator = Materials(), np.random.default_rng(0)
    rows = [materials.add(make(generator)) for make in (cloth, surface)]
    rows.append(materials.add(Material(np.zeros(3), np.ones(3))))
    assert rows == [0, 1, 2] and materials.table().shape == (3, 12)
    assert (materials.table()[:, :6] >= 0).all()


def test_a_sheet_lies_at_its_heights() -> None:
    heights = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    cloth_over = sheet(np.array([0.0, 1, 2]), np.array([5.0, 6]), heights, 0)
    assert_allclose(cloth_over.vertices[:, 1], heights.ravel(), rtol=1e-6)
    assert cloth_over.triangles.shape == (4, 3)
