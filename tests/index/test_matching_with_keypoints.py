"""Matching a silhouette when keypoints are known as well."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.learn import view_joints
from index.build.poses import Poses
from index.build.simulate import Simulation, simulate
from index.keypoints import Keypoints
from index.landmark_search import rotate_clockwise, rotate_silhouette
from index.matching import Hypothesis, Match, match
from index.skeleton import JOINTS, LIMBS, POINT_NAMES, POINTS, exchange_sides, mirror_normalised
from index.store import PoseIndex

ROWS = tuple(POINT_NAMES.index(name) for name in LIMBS)


def keypoints_of(points: NDArray[np.floating], score: float = 0.9) -> Keypoints:
    """Keypoints on the limbs of points ``(19 or 24, 2)``."""
    return Keypoints(ROWS, np.asarray(points, np.float64)[list(ROWS)], np.full(len(ROWS), score))


@pytest.fixture(scope="module")
def strangers(poses: Poses, avatars: list[Avatar]) -> Simulation:
    """The poses of the index seen by cameras it does not know."""
    return simulate(poses, avatars, bodies=1, views=1, seed=98)


def some_strangers(strangers: Simulation) -> list[tuple[NDArray[np.uint8], NDArray[np.float64]]]:
    """Every twelfth silhouette with its joints."""
    _, truth = view_joints(strangers)
    return list(zip(strangers.silhouettes(slice(None)), truth, strict=True))[::12]


def likeliest(found: Match) -> Hypothesis:
    return max(found.hypotheses, key=lambda h: h.log_likelihood + min(0.0, h.side_odds))


def error_px(hypothesis: Hypothesis, joints: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(hypothesis.points_normalised[:JOINTS] - joints, axis=-1).mean())


def test_poses_come_nearer_to_the_truth(toy_index: PoseIndex, strangers: Simulation) -> None:
    seen, unseen = [], []
    for silhouette, joints in some_strangers(strangers):
        unseen.append(error_px(match(toy_index, silhouette, 7).hypotheses[0], joints))
        found = match(toy_index, silhouette, 7, keypoints_of(joints))
        seen.append(error_px(likeliest(found), joints))
    assert np.mean(seen) < 0.6 * np.mean(unseen)


def test_keypoints_tell_left_from_right(toy_index: PoseIndex, strangers: Simulation) -> None:
    as_asked = []
    for silhouette, joints in some_strangers(strangers):
        padded = np.concatenate([joints, np.zeros((POINTS - JOINTS, 2))])
        for wanted in (padded, exchange_sides(padded)):
            best = likeliest(match(toy_index, silhouette, 7, keypoints_of(wanted)))
            apart = error_px(best, wanted[:JOINTS])
            as_asked.append(apart <= error_px(best, exchange_sides(wanted)[:JOINTS]))
    assert np.mean(as_asked) > 0.9


@pytest.mark.parametrize("number", [40, 300])
@pytest.mark.parametrize("lean", [-30.0, 15.0, 45.0])
def test_a_leaning_person_is_told_to_lean(toy_index: PoseIndex, number: int, lean: float) -> None:
    silhouette, inverse = rotate_silhouette(toy_index.silhouette(number), lean)
    points = toy_index.entry(number).points_normalised
    leaning = (points - inverse[:, 2]) @ np.linalg.inv(inverse[:, :2]).T
    best = likeliest(match(toy_index, silhouette, 7, keypoints_of(leaning)))
    assert best.rotation_deg == lean
    assert error_px(best, leaning[:JOINTS]) < 4
    # Set upright, its outline is that of the entry.
    assert best.reprojection_error_px < 2


def test_a_silhouette_that_tells_nothing_is_answered_from_the_keypoints(
    toy_index: PoseIndex,
) -> None:
    """A full rectangle: who is within it, only the keypoints say."""
    body = np.ones((128, 48), np.uint8)
    for number in (40, 301, 500):
        joints = toy_index.entry(number).points_normalised[:JOINTS]
        seen = likeliest(match(toy_index, body, 7, keypoints_of(joints)))
        assert error_px(seen, joints) < 5
        by_silhouette = (error_px(h, joints) for h in match(toy_index, body, 7).hypotheses[:7])
        assert error_px(seen, joints) < min(by_silhouette)


@pytest.mark.parametrize("number", [7, 202, 480])
def test_mirrored_queries_give_mirrored_answers(toy_index: PoseIndex, number: int) -> None:
    silhouette = toy_index.silhouette(number)
    points = toy_index.entry(number).points_normalised
    here = likeliest(match(toy_index, silhouette, 5, keypoints_of(points)))
    there = likeliest(match(
        toy_index, silhouette[:, ::-1], 5, keypoints_of(mirror_normalised(points))
    ))  # fmt: skip
    assert there.entry == here.entry
    assert there.mirrored != here.mirrored
    assert there.log_likelihood == pytest.approx(here.log_likelihood, abs=0.05)


@pytest.mark.parametrize("n", [1, 7, 50])
def test_hypotheses_are_as_many_as_asked_finite_and_distinct(toy_index: PoseIndex, n: int) -> None:
    keypoints = keypoints_of(toy_index.entry(9).points_normalised, score=0.3)
    found = match(toy_index, toy_index.silhouette(9), n, keypoints).hypotheses
    assert len(found) >= n
    assert len({(h.entry, h.mirrored, h.rotation_deg) for h in found}) == len(found)
    for hypothesis in found:
        assert hypothesis.points_3d.shape == (POINTS, 3)
        assert np.isfinite(hypothesis.points_3d).all()
        assert np.isfinite(hypothesis.points_normalised).all()
        assert 0 <= hypothesis.confidence <= 1
        assert hypothesis.log_likelihood <= 0


def test_without_keypoints_there_is_no_likelihood_and_no_rotation(toy_index: PoseIndex) -> None:
    for hypothesis in match(toy_index, toy_index.silhouette(9), 5).hypotheses:
        assert (hypothesis.log_likelihood, hypothesis.side_odds) == (0, 0)
        assert hypothesis.rotation_deg == 0


@pytest.mark.parametrize("number", [40, 300, 520])
@pytest.mark.parametrize("angle", [-170.0, -90.0, -70.0, 35.0, 90.0, 110.0, 180.0])
def test_whichever_way_somebody_lies_the_pose_follows_the_picture(
    toy_index: PoseIndex, number: int, angle: float
) -> None:
    """Asked as they lie in the picture, and rotated to stand."""
    entry = toy_index.entry(number)
    lying, to_entry = rotate_silhouette(toy_index.silhouette(number), angle)
    points = (entry.points_normalised - to_entry[:, 2]) @ np.linalg.inv(to_entry[:, :2]).T
    as_it_is = likeliest(match(toy_index, lying, 7, keypoints_of(points)))
    stood_up = likeliest(
        match(
            toy_index, toy_index.silhouette(number), 7, keypoints_of(entry.points_normalised),
            roll_deg=-angle,
        )
    )  # fmt: skip
    assert error_px(as_it_is, points[:JOINTS]) < 4
    assert error_px(stood_up, entry.points_normalised[:JOINTS]) < 4
    expected = rotate_clockwise(entry.points_3d, angle)
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
        keypoints = keypoints_of(entry.points_normalised)
        best = likeliest(match(ground_index, silhouette, 5, keypoints, roll_deg=entry.roll_deg))
        assert (best.entry, best.mirrored) == (number, mirrored)
        assert best.tilt_deg == pytest.approx(0, abs=1e-4)
        assert best.posture == "lying"
        expected = rotate_clockwise(entry.points_3d, -entry.roll_deg)
        assert np.linalg.norm(best.points_3d - expected, axis=-1).mean() < 0.1


@pytest.mark.parametrize("roll_deg", [-90.0, 60.0, 120.0])
def test_rotated_to_stand_a_silhouette_that_tells_nothing_is_answered_from_the_keypoints(
    toy_index: PoseIndex, roll_deg: float
) -> None:
    """People who lean or lie, seen by cameras that are not rolled."""
    rectangle = np.ones((128, 48), np.uint8)
    for number in (40, 301, 500):
        points = toy_index.entry(number).points_normalised
        found = match(toy_index, rectangle, 7, keypoints_of(points), roll_deg=roll_deg)
        best = likeliest(found)
        assert error_px(best, points[:JOINTS]) < 6
        assert abs((best.tilt_deg + roll_deg + 180) % 360 - 180) < 20


def test_entries_rolled_to_stand_are_found_by_the_keypoints_alone(ground_index: PoseIndex) -> None:
    rectangle = np.ones((128, 48), np.uint8)
    rolled = np.flatnonzero(np.abs(ground_index.entries["roll_deg"]) > 60)[::31]
    for number in rolled.tolist():
        entry = ground_index.entry(number)
        keypoints = keypoints_of(entry.points_normalised)
        best = likeliest(match(ground_index, rectangle, 7, keypoints, roll_deg=entry.roll_deg))
        assert error_px(best, entry.points_normalised[:JOINTS]) < 6
