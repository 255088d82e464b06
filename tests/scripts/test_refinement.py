"""What the refiner is trained on: drawn people, their scenes, and faults like the network's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from index.skeleton import POINT_NAMES, POINTS
from scripts.experiments.real_data import tight_box
from scripts.refinement.measure import covered
from scripts.refinement.samples import spoil
from scripts.refinement.scenes import LEAST_VISIBLE, make_scene
from scripts.refinement.shading import rasterise, vertex_normals
from scripts.refinement.sprites import Sprite, pieces_of

LEFT, RIGHT = (POINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right"))


def ball(radius: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A sphere of 24 x 12 patches, wound so that its normals point outwards."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 24, endpoint=False), indexing="ij"
    )
    points = np.stack(
        [np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], -1
    )
    at = np.arange(13 * 24).reshape(13, 24)
    a, b = at[:-1], at[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    triangles = np.stack([a, c, b, c, d, b], -1).reshape(-1, 3)
    return (radius * points.reshape(-1, 3)).astype(np.float32), triangles.astype(np.int32)


def test_a_balls_normals_point_away_from_its_middle() -> None:
    vertices, triangles = ball(2.0)
    normals = vertex_normals(vertices, triangles)
    assert np.allclose(np.abs((normals * vertices).sum(axis=1)), 2.0, atol=0.05)


def test_a_drawn_ball_is_a_disc_that_shows_its_near_side() -> None:
    vertices, triangles = ball(20.0)
    plane = vertices[:, :2] + 30
    shown, buffer = rasterise(
        np.ascontiguousarray(plane), np.ascontiguousarray(vertices[:, 2]), triangles, vertices,
        60, 60,
    )  # fmt: skip
    assert np.count_nonzero(shown >= 0) == pytest.approx(np.pi * 20**2, rel=0.03)
    assert buffer[30, 30] == pytest.approx([0, 0, -20], abs=1)
    row, column = np.nonzero(shown >= 0)
    assert np.allclose(buffer[row, column, 0], column - 30, atol=1e-3)
    assert np.allclose(buffer[row, column, 1], row - 30, atol=1e-3)


def test_separate_surfaces_are_separate_pieces() -> None:
    vertices, triangles = ball(1.0)
    both = np.concatenate([triangles, triangles + len(vertices)])
    pieces = pieces_of(both, 2 * len(vertices))
    assert len(set(pieces.tolist())) == 2
    assert len(set(pieces[: len(triangles)].tolist())) == 1


@pytest.fixture
def sprites() -> list[Sprite]:
    cover = np.zeros((120, 60), np.float32)
    cover[4:-4, 15:45] = 1
    # The left shoulder is marked by where it is, and the right one beside it.
    points = np.full((POINTS, 2), 30.0)
    points[LEFT], points[RIGHT] = (39.5, 20.0), (19.5, 20.0)
    colours = [np.full((120, 60, 3), level, np.uint8) for level in (40, 200)]
    return [Sprite(colour, cover, cover, points, 30.0) for colour in colours]


@pytest.fixture
def backgrounds() -> list[NDArray[np.uint8]]:
    return [np.random.default_rng(5).integers(0, 255, (200, 300, 3), np.uint8)]


def test_scenes_repeat_themselves(
    sprites: list[Sprite], backgrounds: list[NDArray[np.uint8]]
) -> None:
    first, second = (make_scene(sprites, backgrounds, np.random.default_rng(8)) for _ in range(2))
    assert (first.frame == second.frame).all() and first.boxes == second.boxes


def test_everybody_in_a_scene_is_in_a_box(
    sprites: list[Sprite], backgrounds: list[NDArray[np.uint8]]
) -> None:
    generator = np.random.default_rng(9)
    for _ in range(25):
        scene = make_scene(sprites, backgrounds, generator)
        assert len(scene.boxes) == len(scene.covers) >= 1
        assert scene.covers.shape[1:] == scene.frame.shape[:2]
        assert scene.covers.sum(axis=0).max() < 1.01
        for box, cover in zip(scene.boxes, scene.covers, strict=True):
            assert box.iou(tight_box(cover > 0.5)) > 0.6
    assert 0 < LEAST_VISIBLE < 1


def test_what_hands_carry_is_nobodys(
    sprites: list[Sprite], backgrounds: list[NDArray[np.uint8]]
) -> None:
    own = sprites[0].cover.copy()
    own[60:] = 0
    laden = [dataclasses.replace(sprite, own=own) for sprite in sprites]
    for seed in range(10):
        free, burdened = (
            make_scene(some, backgrounds, np.random.default_rng(seed)) for some in (sprites, laden)
        )
        if len(free.boxes) == 1 == len(burdened.boxes) and free.frame.shape == burdened.frame.shape:
            assert 0.3 < burdened.covers.sum() / free.covers.sum() < 0.7
            break
    else:
        pytest.fail("expected a scene with one person")


def test_points_stay_on_the_body_with_left_on_its_side(
    sprites: list[Sprite], backgrounds: list[NDArray[np.uint8]]
) -> None:
    generator = np.random.default_rng(10)
    mirrored = set()
    for _ in range(25):
        scene = make_scene(sprites, backgrounds, generator)
        for cover, points in zip(scene.covers, scene.points, strict=True):
            box = tight_box(cover > 0.5)
            whole = cover.sum() > 0.9 * box.width * box.height and 3.6 < box.height / box.width < 4
            if not whole:
                continue
            height = box.height / 112
            middle = (box.x + box.right) / 2
            assert points[LEFT, 1] == pytest.approx(box.y + 16.5 * height, abs=2.5)
            assert abs(points[LEFT, 0] - middle) == pytest.approx(10 * height, abs=2.5)
            assert points[LEFT, 0] + points[RIGHT, 0] == pytest.approx(2 * middle, abs=3)
            mirrored.add(bool(points[LEFT, 0] < points[RIGHT, 0]))
    # A mirrored body's left is exchanged with its right: the left one stays on the same side.
    assert mirrored == {False}


def test_mirrored_people_are_seen_from_the_other_side(
    sprites: list[Sprite], backgrounds: list[NDArray[np.uint8]]
) -> None:
    generator = np.random.default_rng(11)
    scenes = [make_scene(sprites, backgrounds, generator) for _ in range(10)]
    assert {a for scene in scenes for a in scene.azimuth_deg} == {-30.0, 30.0}
    assert all(len(scene.azimuth_deg) == len(scene.covers) for scene in scenes)


def test_spoilt_answers_still_know_something_of_the_person() -> None:
    generator = np.random.default_rng(3)
    truth = np.zeros((192, 128), np.uint8)
    truth[20:170, 40:90] = 255
    overlaps = []
    for _ in range(40):
        spoilt = spoil(truth, generator)
        assert spoilt.shape == truth.shape and spoilt.dtype == np.uint8
        found = spoilt > 127
        overlaps.append((found & (truth > 0)).sum() / (found | (truth > 0)).sum())
    assert 0.6 < np.mean(overlaps) < 0.97
    assert min(overlaps) < 0.8


def test_joints_are_covered_inside_and_just_beside_a_silhouette() -> None:
    mask = np.zeros((40, 40), bool)
    mask[10:30, 10:30] = True
    joints = np.array([[20, 20], [32, 20], [36, 20], [-5, 20], [np.nan, 3], [39.4, 39.4]])
    assert covered(mask, joints, 3.0).tolist() == [True, True, False, False, False, False]
