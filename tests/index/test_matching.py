"""What a caller of ``match`` may rely on, whatever ranks the hypotheses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.descriptor_learning import view_joints
from index.build.poses import Poses
from index.build.simulate import Simulation, simulate
from index.confidence import RIGHT_BELOW_PX
from index.matching import DISTINCT_M, FIRST_HYPOTHESES, Hypothesis, match
from index.posture import Posture
from index.search import rotate_clockwise
from index.skeleton import JOINTS, POINTS, mean_joint_distance, mirror_3d, mirror_normalised
from index.store import PoseIndex

QUERIES = range(0, 576, 61)


def best_hypotheses(index: PoseIndex, silhouette: NDArray[np.uint8], n: int) -> list[Hypothesis]:
    return match(index, silhouette, n).hypotheses[:n]


@pytest.fixture(scope="module")
def strangers(poses: Poses, avatars: list[Avatar]) -> Simulation:
    """The poses of the index seen by cameras it does not know."""
    return simulate(poses, avatars, bodies=1, views=1, seed=99)


def test_strangers_are_recognised(toy_index: PoseIndex, strangers: Simulation) -> None:
    """Poses it knows, views it does not: mostly within 5 px, as the paper counts."""
    _, truth = view_joints(strangers)
    errors = [
        min(
            np.linalg.norm(h.points_normalised[:JOINTS] - joints, axis=-1).mean()
            for h in best_hypotheses(toy_index, silhouette, 7)
        )
        for silhouette, joints in zip(strangers.silhouettes(slice(None)), truth, strict=True)
    ]
    assert np.mean(np.array(errors) < RIGHT_BELOW_PX) > 0.6


@pytest.mark.parametrize("number", QUERIES)
def test_own_silhouette_comes_first(toy_index: PoseIndex, number: int) -> None:
    best = best_hypotheses(toy_index, toy_index.silhouette(number), 3)[0]
    assert best.entry == number
    assert best.distance == pytest.approx(0, abs=1e-3)
    assert best.reprojection_error_px == pytest.approx(0, abs=1e-6)
    # Its pose, but for averaging with near neighbours of the same mode.
    apart = np.linalg.norm(best.points_3d - toy_index.entry(number).points_3d, axis=-1)
    assert apart.mean() < 0.11


@pytest.mark.parametrize("number", QUERIES)
def test_mirrored_silhouette_gives_mirrored_answers(toy_index: PoseIndex, number: int) -> None:
    silhouette = toy_index.silhouette(number)
    there, here = (best_hypotheses(toy_index, s, 3) for s in (silhouette[:, ::-1], silhouette))
    # Where two candidates tie, rounding may choose another centre: the best one must agree.
    assert there[0].entry == here[0].entry
    assert there[0].mirrored != here[0].mirrored
    assert there[0].confidence == pytest.approx(here[0].confidence, abs=1e-3)
    assert_allclose(there[0].points_3d, mirror_3d(here[0].points_3d), atol=1e-3)
    assert_allclose(
        there[0].points_normalised, mirror_normalised(here[0].points_normalised), atol=0.05
    )


def assert_later_poses_are_others(found: list[Hypothesis]) -> None:
    """Those of a batch than those of the batches before, where batches certainly end."""
    poses = np.array([h.points_3d for h in found])
    for row in range(2 * FIRST_HYPOTHESES, len(found)):
        assert mean_joint_distance(poses[row][None], poses[:FIRST_HYPOTHESES]).min() >= DISTINCT_M


@pytest.mark.parametrize("n", [1, 2, 7, 20])
@pytest.mark.parametrize("number", [5, 300])
def test_hypotheses_are_as_many_as_asked_ascending_distinct_and_finite(
    toy_index: PoseIndex, number: int, n: int
) -> None:
    silhouette = toy_index.silhouette(number)
    found = best_hypotheses(toy_index, silhouette, n)
    assert len(found) == n
    distances = [h.fused_distance for h in found]
    assert distances == sorted(distances)
    # Those of a later batch are told to be no nearer than those before.
    assert all(h.fused_distance >= h.distance for h in found)
    first = found[:FIRST_HYPOTHESES]
    assert all(h.fused_distance == h.distance for h in first)
    assert len({(h.entry, h.mirrored) for h in first}) == len(first)
    assert_later_poses_are_others(found)
    joints = np.stack([h.points_3d[:JOINTS] for h in first])
    apart = np.sqrt(((joints[:, None] - joints[None]) ** 2).sum(axis=-1).mean(axis=-1))
    # Interpolation may bring distinct poses a little nearer.
    assert (apart[~np.eye(len(first), dtype=bool)] > 0.05).all()
    for hypothesis in found:
        assert hypothesis.points_3d.shape == (POINTS, 3)
        assert np.isfinite(hypothesis.points_3d).all()
        assert np.isfinite(hypothesis.points_normalised).all()
        assert 0 <= hypothesis.confidence <= 1
        assert hypothesis.distance >= 0
        assert hypothesis.reprojection_error_px >= 0
    again = best_hypotheses(toy_index, silhouette, n)
    assert [h.entry for h in again] == [h.entry for h in found]


def test_asks_for_more_than_there_is(toy_index: PoseIndex) -> None:
    found = best_hypotheses(toy_index, toy_index.silhouette(0), 10_000)
    assert 20 < len(found) <= len(toy_index)
    assert_later_poses_are_others(found)


@pytest.mark.parametrize("drawn", ["full", "dot"])
def test_answers_degenerate_silhouettes(toy_index: PoseIndex, drawn: str) -> None:
    silhouette = np.zeros((128, 48), np.uint8)
    silhouette[(slice(None), slice(None)) if drawn == "full" else (60, 20)] = 1
    for hypothesis in best_hypotheses(toy_index, silhouette, 2):
        assert np.isfinite([hypothesis.distance, hypothesis.confidence]).all()
        assert np.isfinite(hypothesis.reprojection_error_px)


def rolled_entries(index: PoseIndex) -> list[int]:
    """Some of the entries that were rolled to stand."""
    return np.flatnonzero(np.abs(index.entries["roll_deg"]) > 30)[::17].tolist()


def roll_of(index: PoseIndex, number: int) -> float:
    return float(index.entries["roll_deg"][number])


def best(index: PoseIndex, silhouette: NDArray[np.uint8], roll_deg: float) -> Hypothesis:
    return match(index, np.ascontiguousarray(silhouette), 3, roll_deg=roll_deg).hypotheses[0]


def apart(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(one - other, axis=-1).mean())


class TestRolledQueries:
    """Silhouettes that were rotated to stand."""

    def test_own_silhouette_comes_first(self, ground_index: PoseIndex) -> None:
        for number in rolled_entries(ground_index):
            roll_deg = roll_of(ground_index, number)
            found = best(ground_index, ground_index.silhouette(number), roll_deg)
            entry = ground_index.entry(number)
            assert (found.entry, found.mirrored) == (number, False)
            assert found.reprojection_error_px == pytest.approx(0, abs=1e-6)
            assert found.rotation_deg == pytest.approx(-roll_deg)
            assert found.tilt_deg == pytest.approx(0, abs=1e-4)
            # In the picture as it was asked, in space as the camera stood.
            assert apart(found.points_normalised, entry.points_normalised) < 3
            assert apart(found.points_3d, rotate_clockwise(entry.points_3d, -roll_deg)) < 0.1

    def test_either_way_up_it_is_the_same_body(self, ground_index: PoseIndex) -> None:
        for number in rolled_entries(ground_index):
            roll_deg, silhouette = roll_of(ground_index, number), ground_index.silhouette(number)
            here = best(ground_index, silhouette, roll_deg)
            there = best(ground_index, silhouette[::-1, ::-1], roll_deg + 180)
            assert there.entry == here.entry
            assert there.posture == here.posture
            assert there.tilt_deg == pytest.approx(here.tilt_deg, abs=1e-4)
            assert apart(there.points_3d, here.points_3d) < 0.03
            frame = np.array(silhouette.shape[::-1]) - 1
            assert apart(frame - there.points_normalised, here.points_normalised) < 1


class TestPostures:
    def test_who_lies_lies_and_who_stands_stands(self, ground_index: PoseIndex) -> None:
        actions = ground_index.skeleton_labels["action"][ground_index.entries["skeleton"]]
        told: dict[str, list[Posture]] = {"lying": [], "standing": []}
        for number in range(0, len(ground_index), 13):
            roll_deg = roll_of(ground_index, number)
            roll_deg = roll_deg if abs(roll_deg) > 30 else 0.0
            found = best(ground_index, ground_index.silhouette(number), roll_deg)
            told["lying" if actions[number] > 1 else "standing"].append(found.posture)
        for posture, answers in told.items():
            assert np.mean([answer == posture for answer in answers]) > 0.95

    @pytest.mark.parametrize("quarter", [-90.0, 90.0])
    def test_who_stands_in_a_picture_turned_by_a_quarter_lies(
        self, toy_index: PoseIndex, quarter: float
    ) -> None:
        answers, tilts = [], []
        for number in range(0, len(toy_index), 29):
            found = best(toy_index, toy_index.silhouette(number), -quarter)
            answers.append(found.posture)
            tilts.append(found.tilt_deg)
        # A few in mid-stride rest on a leg, their trunk off the ground: on all fours.
        assert np.mean([answer == "lying" for answer in answers]) > 0.8
        assert not {"standing", "walking"} & set(answers)
        # Cameras roll a little themselves.
        assert_allclose(tilts, quarter, atol=10)
