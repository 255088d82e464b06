"""Meshes, the rasteriser, rooms, cameras and development: what a picture must hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("numba")

from scripts.training.render import furniture
from scripts.training.render.cut_outs import inflated
from scripts.training.render.jointed import jointed_thing
from scripts.training.render.materials import Materials
from scripts.training.render.meshes import wheel
from scripts.training.render.raster import NOTHING, rasterise
from scripts.training.render.rooms import build_room

SEEDS = st.integers(0, 1000)


@given(SEEDS)
def test_bodies_of_all_kinds_are_finite(seed: int) -> None:
    generator, materials = np.random.default_rng(seed), Materials()
    makers = (*furniture.SUBJECTS, *furniture.CLUTTER, jointed_thing)
    mesh = makers[seed % len(makers)](materials, generator)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.triangles.max() < len(mesh.vertices)
    assert mesh.materials.max() < len(materials.rows)
    assert mesh.vertices[:, 1].min() > -0.7 and np.abs(mesh.vertices).max() < 4
    wheel_at = wheel([0, 0.3, 0], [1, 0, 0], 0.3, 0.02, 0)
    assert np.isfinite(wheel_at.vertices).all()


@given(SEEDS)
def test_a_cut_out_becomes_a_body_of_its_shape_and_colours(seed: int) -> None:
    picture = np.zeros((60, 90, 4), np.uint8)
    picture[10:50, 20:80] = [0, 0, 255, 255]
    materials = Materials()
    body = inflated([picture], materials, np.random.default_rng(seed))
    wide, high, deep = np.ptp(body.vertices, axis=0)
    assert 1.4 < wide / high < 1.6 and deep < 1.4 * high
    if len(materials.rows) != 2:
        return  # In one cloth.
    red, green, blue = materials.table()[0, :3]
    assert red > 10 * max(green, blue)


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


@given(SEEDS)
def test_rooms_hold_who_is_in_them(seed: int) -> None:
    places = np.random.default_rng(seed).uniform([-2, 0.5, -2], [2, 4.5, 2], (3, 3))
    room = build_room(places, 0.2, np.random.default_rng(seed))
    inside = places @ room.turn.T
    assert (inside > room.corners[0]).all() and (inside < room.corners[1]).all()
    assert room.corners[0, 1] == pytest.approx(0.2)
    assert room.materials.shape == (6, 12) and room.panels.shape[1] == 18
