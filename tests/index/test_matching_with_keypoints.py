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
from index.leans import turned
from index.matching import Hypothesis, leaning_further, match, match_with_spares
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


def likeliest(found: list[Hypothesis]) -> Hypothesis:
    return max(found, key=lambda one: one.log_likelihood + min(0.0, one.side_odds))


def error_px(one: Hypothesis, joints: NDArray[np.floating]) -> float:
    return float(np.linalg.norm(one.points_normalised[:JOINTS] - joints, axis=-1).mean())


def test_poses_come_nearer_to_the_truth(toy_index: PoseIndex, strangers: Simulation) -> None:
    seen, unseen = [], []
    for silhouette, joints in some_strangers(strangers):
        unseen.append(error_px(match(toy_index, silhouette, 7)[0], joints))
        found = match_with_spares(toy_index, silhouette, 7, keypoints_of(joints))
        seen.append(error_px(likeliest(found), joints))
    assert np.mean(seen) < 0.6 * np.mean(unseen)


def test_keypoints_tell_left_from_right(toy_index: PoseIndex, strangers: Simulation) -> None:
    as_asked = []
    for silhouette, joints in some_strangers(strangers):
        padded = np.concatenate([joints, np.zeros((POINTS - JOINTS, 2))])
        for wanted in (padded, exchange_sides(padded)):
            best = likeliest(match_with_spares(toy_index, silhouette, 7, keypoints_of(wanted)))
            apart = error_px(best, wanted[:JOINTS])
            as_asked.append(apart <= error_px(best, exchange_sides(wanted)[:JOINTS]))
    assert np.mean(as_asked) > 0.9


@pytest.mark.parametrize("number", [40, 300])
@pytest.mark.parametrize("lean", [-30.0, 15.0, 45.0])
def test_a_leaning_person_is_told_to_lean(toy_index: PoseIndex, number: int, lean: float) -> None:
    silhouette, back = turned(toy_index.silhouette(number), lean)
    points = toy_index.entry(number).points_normalised
    leaning = (points - back[:, 2]) @ np.linalg.inv(back[:, :2]).T
    best = likeliest(match_with_spares(toy_index, silhouette, 7, keypoints_of(leaning)))
    assert best.lean_deg == lean
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
        seen = likeliest(match_with_spares(toy_index, body, 7, keypoints_of(joints)))
        assert error_px(seen, joints) < 5
        by_silhouette = (error_px(one, joints) for one in match(toy_index, body, 7))
        assert error_px(seen, joints) < min(by_silhouette)


@pytest.mark.parametrize("number", [7, 202, 480])
def test_mirrored_queries_give_mirrored_answers(toy_index: PoseIndex, number: int) -> None:
    silhouette = toy_index.silhouette(number)
    points = toy_index.entry(number).points_normalised
    here = likeliest(match_with_spares(toy_index, silhouette, 5, keypoints_of(points)))
    there = likeliest(match_with_spares(
        toy_index, silhouette[:, ::-1], 5, keypoints_of(mirror_normalised(points))
    ))  # fmt: skip
    assert there.entry == here.entry
    assert there.mirrored != here.mirrored
    assert there.log_likelihood == pytest.approx(here.log_likelihood, abs=0.05)


@pytest.mark.parametrize("n", [1, 7, 50])
def test_hypotheses_are_as_many_as_asked_finite_and_distinct(toy_index: PoseIndex, n: int) -> None:
    keypoints = keypoints_of(toy_index.entry(9).points_normalised, score=0.3)
    found = match_with_spares(toy_index, toy_index.silhouette(9), n, keypoints)
    assert len(found) >= n
    assert len({(one.entry, one.mirrored, one.lean_deg) for one in found}) == len(found)
    for one in found:
        assert one.points_3d.shape == (POINTS, 3) and np.isfinite(one.points_3d).all()
        assert np.isfinite(one.points_normalised).all()
        assert 0 <= one.confidence <= 1
        assert one.log_likelihood <= 0


def test_without_keypoints_there_is_no_likelihood_and_no_lean(toy_index: PoseIndex) -> None:
    for one in match_with_spares(toy_index, toy_index.silhouette(9), 5):
        assert (one.log_likelihood, one.side_odds, one.lean_deg) == (0, 0, 0)


def test_leaning_further_turns_the_body_and_back(toy_index: PoseIndex) -> None:
    one = match(toy_index, toy_index.silhouette(9), 1)[0]
    further = leaning_further(one, 90)
    assert further.lean_deg == 90
    # Clockwise: what was up is right, what was right is down.
    x, y, z = one.points_3d.T
    assert np.allclose(further.points_3d.T, [-y, x, z])
    assert np.allclose(leaning_further(further, -90).points_3d, one.points_3d)
