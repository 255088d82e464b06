"""Matching a silhouette when landmarks are known as well."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.descriptor_learning import view_joints
from index.build.poses import Poses
from index.build.simulate import Simulation, simulate
from index.keypoints import Keypoints
from index.matching import Hypothesis, Match, match
from index.rotations import rotate_silhouette
from index.search import rotate_clockwise
from index.skeleton import (
    JOINTS,
    LIMBS,
    POINT_NAMES,
    POINTS,
    exchange_sides,
    mirror_3d,
    mirror_normalised,
)
from index.store import PoseIndex

ROWS = tuple(POINT_NAMES.index(name) for name in LIMBS)


def keypoints_of(
    points: NDArray[np.floating], points_3d: NDArray[np.floating], score: float = 0.9
) -> Keypoints:
    """Landmarks on the limbs of points ``(19 or 24, 2)`` and ``(19 or 24, 3)``."""
    limbs = np.asarray(points_3d, np.float64)[list(ROWS)]
    hips = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
    scores = np.full(len(ROWS), score)
    return Keypoints(
        ROWS,
        np.asarray(points, np.float64)[list(ROWS)],
        scores,
        limbs - limbs[hips].mean(axis=0),
        scores,
    )


def keypoints_of_entry(index: PoseIndex, number: int, **changes: float) -> Keypoints:
    entry = index.entry(number)
    return keypoints_of(entry.points_normalised, entry.points_3d, **changes)


@pytest.fixture(scope="module")
def strangers(poses: Poses, avatars: list[Avatar]) -> Simulation:
    """The poses of the index seen by cameras it does not know."""
    return simulate(poses, avatars, bodies=1, views=1, seed=98)


Stranger = tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]


def some_strangers(strangers: Simulation) -> list[Stranger]:
    """Every twelfth silhouette with its joints in space and in the picture."""
    in_space, in_picture = view_joints(strangers)
    return list(zip(strangers.silhouettes(slice(None)), in_space, in_picture, strict=True))[::12]


def likeliest(found: Match) -> Hypothesis:
    best = found.hypotheses[0]
    assert best.fused_distance == min(one.fused_distance for one in found.hypotheses)
    return best


def error_px(hypothesis: Hypothesis, joints: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(hypothesis.points_normalised[:JOINTS] - joints, axis=-1).mean())


def test_poses_come_nearer_to_the_truth(toy_index: PoseIndex, strangers: Simulation) -> None:
    seen, unseen = [], []
    for silhouette, in_space, joints in some_strangers(strangers):
        unseen.append(error_px(match(toy_index, silhouette, 7).hypotheses[0], joints))
        found = match(toy_index, silhouette, 7, keypoints_of(joints, in_space))
        seen.append(error_px(likeliest(found), joints))
    assert np.mean(seen) < 0.6 * np.mean(unseen)


def test_keypoints_tell_left_from_right(toy_index: PoseIndex, strangers: Simulation) -> None:
    as_asked = []
    for silhouette, in_space, joints in some_strangers(strangers):
        padded = np.concatenate([joints, np.zeros((POINTS - JOINTS, 2))])
        deep = np.concatenate([in_space, np.zeros((POINTS - JOINTS, 3))])
        for wanted, depth in ((padded, deep), (exchange_sides(padded), exchange_sides(deep))):
            best = likeliest(match(toy_index, silhouette, 7, keypoints_of(wanted, depth)))
            apart = error_px(best, wanted[:JOINTS])
            as_asked.append(apart <= error_px(best, exchange_sides(wanted)[:JOINTS]))
    assert np.mean(as_asked) > 0.9


@pytest.mark.parametrize("number", [40, 300])
@pytest.mark.parametrize("lean", [-30.0, 15.0, 45.0])
def test_a_leaning_person_is_told_to_lean(toy_index: PoseIndex, number: int, lean: float) -> None:
    silhouette, inverse = rotate_silhouette(toy_index.silhouette(number), lean)
    entry = toy_index.entry(number)
    leaning = (entry.points_normalised - inverse[:, 2]) @ np.linalg.inv(inverse[:, :2]).T
    keypoints = keypoints_of(leaning, rotate_clockwise(entry.points_3d, lean))
    best = likeliest(match(toy_index, silhouette, 7, keypoints))
    assert abs(best.tilt_deg - lean) < 20
    assert error_px(best, leaning[:JOINTS]) < 4
    # Set upright, its outline is nearly that of the entry.
    assert best.reprojection_error_px < 4


def test_a_silhouette_that_tells_nothing_is_answered_from_the_keypoints(
    toy_index: PoseIndex,
) -> None:
    """A full rectangle: who is within it, only the keypoints say."""
    body = np.ones((128, 48), np.uint8)
    for number in (40, 301, 500):
        joints = toy_index.entry(number).points_normalised[:JOINTS]
        seen = likeliest(match(toy_index, body, 7, keypoints_of_entry(toy_index, number)))
        assert error_px(seen, joints) < 5
        by_silhouette = (error_px(h, joints) for h in match(toy_index, body, 7).hypotheses[:7])
        assert error_px(seen, joints) < min(by_silhouette)


@pytest.mark.parametrize("number", [7, 202, 480])
def test_mirrored_queries_give_mirrored_answers(toy_index: PoseIndex, number: int) -> None:
    silhouette = toy_index.silhouette(number)
    entry = toy_index.entry(number)
    here = match(toy_index, silhouette, 5, keypoints_of_entry(toy_index, number)).hypotheses
    there = match(
        toy_index,
        np.ascontiguousarray(silhouette[:, ::-1]),
        5,
        keypoints_of(mirror_normalised(entry.points_normalised), mirror_3d(entry.points_3d)),
    ).hypotheses
    assert there[0].entry == here[0].entry
    assert there[0].mirrored != here[0].mirrored
    assert there[0].fused_distance == pytest.approx(here[0].fused_distance, rel=0.02, abs=1e-3)
    assert np.abs(there[0].points_3d - mirror_3d(here[0].points_3d)).max() < 0.02
    apart_px = there[0].points_normalised - mirror_normalised(here[0].points_normalised)
    assert np.abs(apart_px).max() < 0.5
    assert there[0].confidence == pytest.approx(here[0].confidence, abs=0.01)
    assert there[0].posture == here[0].posture


def same(one: Hypothesis, other: Hypothesis) -> bool:
    """All of them, to the last bit."""
    return all(np.array_equal(vars(one)[name], vars(other)[name]) for name in vars(one))


@pytest.mark.parametrize(("fewer", "more"), [(3, 7), (7, 14), (10, 20), (1, 50)])
@pytest.mark.parametrize("number", [9, 301])
@pytest.mark.parametrize("evidence", ["silhouette", "landmarks", "landmarks, not whole"])
def test_the_first_of_many_are_those_of_few(
    toy_index: PoseIndex, fewer: int, more: int, number: int, evidence: str
) -> None:
    keypoints = None if evidence == "silhouette" else keypoints_of_entry(toy_index, number)
    few, many = (
        match(
            toy_index, toy_index.silhouette(number), n, keypoints,
            whole=evidence != "landmarks, not whole",
        )
        for n in (fewer, more)
    )  # fmt: skip
    # Where landmarks alone are exact, few of the poses of a small index agree with them.
    assert len(few.hypotheses) >= min(fewer, 7)
    assert len(many.hypotheses) >= len(few.hypotheses[:fewer])
    for one, other in zip(few.hypotheses[:fewer], many.hypotheses, strict=False):
        assert same(one, other)
    shared = min(fewer, len(few.hypotheses))
    assert np.array_equal(few.features[:shared], many.features[:shared])


@pytest.mark.parametrize("number", [40, 301, 500])
def test_who_is_not_seen_whole_is_placed_by_the_landmarks(
    toy_index: PoseIndex, number: int
) -> None:
    """The silhouette ends at the hips and fills the frame; the landmarks say where that is."""
    entry = toy_index.entry(number)
    whole = toy_index.silhouette(number)
    hips = entry.points_normalised[[POINT_NAMES.index(f"{s}_hip") for s in ("left", "right")]]
    upper = whole.copy()
    upper[round(float(hips[:, 1].mean())) :] = 0
    cut, to_whole = rotate_silhouette(upper, 0.0)
    seen = (entry.points_normalised - to_whole[:, 2]) @ np.linalg.inv(to_whole[:, :2]).T
    keypoints = keypoints_of(seen, entry.points_3d)
    best = likeliest(match(toy_index, cut, 7, keypoints, whole=False))
    assert error_px(best, seen[:JOINTS]) < 8
    apart = np.linalg.norm(best.points_3d - entry.points_3d, axis=-1)
    assert apart.mean() < 0.15
    # Nothing depends on what the silhouette shows, but for the order.
    other = match(toy_index, np.ones_like(cut), 7, keypoints, whole=False)
    nearest = min(
        np.linalg.norm(one.points_3d - best.points_3d, axis=-1).mean() for one in other.hypotheses
    )
    assert nearest < 0.1


@pytest.mark.parametrize("number", [40, 300, 520])
@pytest.mark.parametrize("angle", [-170.0, -90.0, -70.0, 35.0, 90.0, 110.0, 180.0])
def test_whichever_way_somebody_lies_the_pose_follows_the_picture(
    toy_index: PoseIndex, number: int, angle: float
) -> None:
    """Asked as they lie in the picture, and rotated to stand."""
    entry = toy_index.entry(number)
    lying, to_entry = rotate_silhouette(toy_index.silhouette(number), angle)
    points = (entry.points_normalised - to_entry[:, 2]) @ np.linalg.inv(to_entry[:, :2]).T
    expected = rotate_clockwise(entry.points_3d, angle)
    as_it_is = likeliest(match(toy_index, lying, 7, keypoints_of(points, expected)))
    stood_up = likeliest(
        match(
            toy_index, toy_index.silhouette(number), 7, keypoints_of_entry(toy_index, number),
            roll_deg=-angle,
        )
    )  # fmt: skip
    assert error_px(as_it_is, points[:JOINTS]) < 4
    assert error_px(stood_up, entry.points_normalised[:JOINTS]) < 4
    for found in (as_it_is, stood_up):
        assert np.linalg.norm(found.points_3d - expected, axis=-1).mean() < 0.2
        off = found.tilt_deg - angle - entry.roll_deg
        assert abs((off + 180) % 360 - 180) < 15


@pytest.mark.parametrize("mirrored", [False, True])
def test_keypoints_find_entries_that_were_rolled_to_stand(
    ground_index: PoseIndex, mirrored: bool
) -> None:
    actions = ground_index.skeleton_labels["action"][ground_index.entries["skeleton"]]
    rolled = np.flatnonzero((np.abs(ground_index.entries["roll_deg"]) > 30) & (actions > 1))[::31]
    for number in rolled.tolist():
        entry = ground_index.entry(number, mirrored=mirrored)
        silhouette = ground_index.silhouette(number)
        if mirrored:
            silhouette = np.ascontiguousarray(silhouette[:, ::-1])
        keypoints = keypoints_of(entry.points_normalised, entry.points_3d)
        best = likeliest(match(ground_index, silhouette, 5, keypoints, roll_deg=entry.roll_deg))
        assert (best.entry, best.mirrored) == (number, mirrored)
        assert best.tilt_deg == pytest.approx(0, abs=1e-4)
        assert best.posture == "lying"
        expected = rotate_clockwise(entry.points_3d, -entry.roll_deg)
        assert np.linalg.norm(best.points_3d - expected, axis=-1).mean() < 0.1
