"""Skeletons bent to maps: nearer to the joints, with the bones they had."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.bending import bend
from index.joint_maps import JointMaps
from index.skeleton import JOINTS, LIMBS, NATIVE, POINT_NAMES, exchange_sides, project
from index.store import PoseIndex

ROWS = tuple(POINT_NAMES.index(name) for name in LIMBS)
SHAPE = (36, 24)
SCALE, OFFSET = 0.25, np.array([6.0, 2.0])


def maps_at(points: NDArray[np.float64], sharpness: float = 1.0) -> JointMaps:
    """Maps that show each limb joint where a skeleton ``(24, 2)`` has it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cells = points[list(ROWS)] * SCALE + OFFSET
    maps = np.stack([np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2) for cx, cy in cells]) ** sharpness
    maps /= maps.sum(axis=(1, 2), keepdims=True)
    return JointMaps(ROWS, maps.astype(np.float32), SCALE, OFFSET)


def bone_lengths(points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    parents, children = np.array(NATIVE.bones).T
    lengths = points_3d[..., children, :] - points_3d[..., parents, :]
    return np.asarray(np.linalg.norm(lengths, axis=-1))


def turned_at(points_3d: NDArray[np.float64], joint: str, angle_deg: float) -> NDArray[np.float64]:
    """A skeleton whose forearm is turned about its elbow in the picture."""
    wrist, elbow = (POINT_NAMES.index(f"{joint}_{part}") for part in ("wrist", "elbow"))
    angle = np.deg2rad(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    changed = points_3d.copy()
    changed[wrist, :2] = changed[elbow, :2] + turn @ (changed[wrist, :2] - changed[elbow, :2])
    return changed


def some(index: PoseIndex, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points_3d, points_normalised = index.points(np.array([number]))
    return points_3d[0], points_normalised[0]


@pytest.mark.parametrize("number", [0, 7, 40])
def test_a_skeleton_where_maps_show_it_stays(toy_index: PoseIndex, number: int) -> None:
    points_3d, points_normalised = some(toy_index, number)
    bent, placed = bend(maps_at(points_normalised), points_3d[None], points_normalised[None])
    assert_allclose(placed[0, :JOINTS], points_normalised[:JOINTS], atol=1.0)
    assert_allclose(bent[0], points_3d, atol=0.02)


@pytest.mark.parametrize("number", [0, 7, 40])
@pytest.mark.parametrize("angle", [-35.0, 35.0])
def test_a_forearm_is_turned_to_where_it_is_shown(
    toy_index: PoseIndex, number: int, angle: float
) -> None:
    points_3d, points_normalised = some(toy_index, number)
    true = turned_at(points_3d, "left", angle)
    scale = np.linalg.lstsq(
        project(points_3d, 4.0).ravel()[:, None] * 1.0,
        (points_normalised - points_normalised[0]).ravel(), rcond=None,
    )[0][0]  # fmt: skip
    shown = points_normalised + scale * (project(true, 4.0) - project(points_3d, 4.0))
    bent, placed = bend(maps_at(shown), points_3d[None], points_normalised[None])
    wrist = POINT_NAMES.index("left_wrist")
    before = np.linalg.norm(points_normalised[wrist] - shown[wrist])
    assert np.linalg.norm(placed[0, wrist] - shown[wrist]) < 0.4 * before
    assert np.linalg.norm(bent[0, wrist] - true[wrist]) < np.linalg.norm(
        points_3d[wrist] - true[wrist]
    )
    assert_allclose(bone_lengths(bent[0]), bone_lengths(points_3d), rtol=1e-9)
    # The other arm and the legs are where they were.
    others = [row for row in range(JOINTS) if "left_wrist" not in POINT_NAMES[row]]
    assert_allclose(placed[0, others], points_normalised[others], atol=2.5)


def test_flat_maps_bend_nothing(toy_index: PoseIndex) -> None:
    points_3d, points_normalised = some(toy_index, 3)
    flat = maps_at(points_normalised, sharpness=0.0)
    bent, placed = bend(flat, points_3d[None], points_normalised[None])
    assert_allclose(placed[0], points_normalised, atol=3)
    assert_allclose(bent[0], points_3d, atol=0.06)


def test_sides_exchanged_are_bent_alike(toy_index: PoseIndex) -> None:
    """Which side is which is settled elsewhere: a twin is bent where its points are."""
    points_3d, points_normalised = some(toy_index, 12)
    maps = maps_at(points_normalised + np.random.default_rng(0).normal(0, 2, (24, 2)))
    bent, placed = bend(maps, points_3d[None], points_normalised[None])
    twin = bend(maps, exchange_sides(points_3d[None]), exchange_sides(points_normalised[None]))
    limbs = list(ROWS)
    assert_allclose(exchange_sides(twin[1])[0, limbs], placed[0, limbs], atol=1e-6)
    assert_allclose(exchange_sides(twin[0])[0, limbs], bent[0, limbs], atol=1e-6)
