"""Matching a silhouette when maps of the joints are known as well."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.learn import view_joints
from index.build.poses import Poses
from index.build.simulate import Simulation, simulate
from index.joint_maps import JointMaps
from index.leans import turned
from index.matching import Hypothesis, match_with_spares
from index.skeleton import JOINTS, POINT_NAMES, POINTS, exchange_sides
from index.store import PoseIndex

ROWS = tuple(POINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right")
             for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))  # fmt: skip
CELLS_PER_PX, SHAPE = 0.25, (40, 24)
OFFSET = np.array([6.0, 4.0])


def maps_of(points: NDArray[np.floating]) -> JointMaps:
    """Maps that know joints ``(19 or 24, 2)`` to within two pixels."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cells = points[list(ROWS)] * CELLS_PER_PX + OFFSET
    maps = np.stack([np.exp(-2 * ((x - cx) ** 2 + (y - cy) ** 2)) + 1e-9 for cx, cy in cells])
    maps /= maps.sum(axis=(1, 2), keepdims=True)
    return JointMaps(ROWS, maps.astype(np.float32), CELLS_PER_PX, OFFSET)


@pytest.fixture(scope="module")
def strangers(poses: Poses, avatars: list[Avatar]) -> Simulation:
    """The poses of the index seen by cameras it does not know."""
    return simulate(poses, avatars, bodies=1, views=1, seed=98)


def likeliest(found: list[Hypothesis]) -> Hypothesis:
    return max(found, key=lambda one: one.log_likelihood + min(0.0, one.side_odds))


def error_px(one: Hypothesis, joints: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(one.points_normalised[:JOINTS] - joints, axis=-1).mean())


def test_poses_come_nearer_to_the_truth(toy_index: PoseIndex, strangers: Simulation) -> None:
    _, truth = view_joints(strangers)
    with_maps, without = [], []
    silhouettes = strangers.silhouettes(slice(None))
    for silhouette, joints in list(zip(silhouettes, truth, strict=True))[::12]:
        without.append(error_px(match_with_spares(toy_index, silhouette, 7)[0], joints))
        found = match_with_spares(toy_index, silhouette, 7, maps_of(joints))
        with_maps.append(error_px(likeliest(found), joints))
    assert np.mean(with_maps) < 0.7 * np.mean(without)


def test_maps_tell_left_from_right(toy_index: PoseIndex, strangers: Simulation) -> None:
    _, truth = view_joints(strangers)
    as_asked = []
    silhouettes = strangers.silhouettes(slice(None))
    for silhouette, joints in list(zip(silhouettes, truth, strict=True))[::12]:
        padded = np.concatenate([joints, np.zeros((POINTS - JOINTS, 2))])
        for wanted in (padded, exchange_sides(padded)):
            found = match_with_spares(toy_index, silhouette, 7, maps_of(wanted))
            best = likeliest(found)
            apart = error_px(best, wanted[:JOINTS])
            as_asked.append(apart <= error_px(best, exchange_sides(wanted)[:JOINTS]))
    assert np.mean(as_asked) > 0.9


def test_a_leaning_person_is_told_to_lean(toy_index: PoseIndex) -> None:
    number, lean = 40, 15.0
    silhouette, back = turned(toy_index.silhouette(number), lean)
    points = toy_index.entry(number).points_normalised
    leaning = (points - back[:, 2]) @ np.linalg.inv(back[:, :2]).T
    best = likeliest(match_with_spares(toy_index, silhouette, 7, maps_of(leaning)))
    assert best.lean_deg == lean
    assert error_px(best, leaning[:JOINTS]) < 4
    # Set upright, its outline is that of the entry.
    assert best.reprojection_error_px < 2


def test_nothing_known_changes_no_likelihood(toy_index: PoseIndex) -> None:
    flat = np.full((len(ROWS), *SHAPE), 1 / (SHAPE[0] * SHAPE[1]), np.float32)
    maps = JointMaps(ROWS, flat, CELLS_PER_PX, OFFSET)
    found = match_with_spares(toy_index, toy_index.silhouette(9), 5, maps)
    assert len(found) >= 5
    for one in found:
        assert one.points_3d.shape == (POINTS, 3) and np.isfinite(one.points_3d).all()
        assert 0 <= one.confidence <= 1
    assert all(one.log_likelihood == 0 for one in match_with_spares(toy_index, flat_body(), 3))


def flat_body() -> NDArray[np.uint8]:
    body = np.zeros((128, 48), np.uint8)
    body[:, 12:36] = 1
    return body
