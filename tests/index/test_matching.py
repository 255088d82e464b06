"""Matching silhouettes, without and with landmarks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from descriptor.silhouette import rotate_silhouette
from index.confidence import RIGHT_BELOW_PX
from index.landmark_matching import match_landmarks, moved_along
from index.matching import DEFAULT_HYPOTHESES, MIN_NEW_POSE_M, Match, PoseHypothesis
from index.modes import DISTINCT_M
from index.silhouette_matching import match_silhouette
from index.skeleton import (
    JOINTS,
    POINT_NAMES,
    camera_rotation,
    exchange_sides,
    mean_joint_distance,
    project,
    rotate_clockwise,
    side_rows,
)
from index.store import PoseIndex
from tests.index.helpers import joint_error, landmarks_of, points_of
from tests.support.figures import drawn, movement

QUERIES = range(0, 576, 61)


def best_hypotheses(
    index: PoseIndex, silhouette: NDArray[np.uint8], n: int
) -> list[PoseHypothesis]:
    return match_silhouette(index, silhouette, n).hypotheses[:n]


View = tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]


@pytest.fixture(scope="module")
def new_views() -> list[View]:
    """Poses of the index in views that it does not have: silhouette, joints, joints in pixels."""
    generator, found = np.random.default_rng(99), []
    for skeleton in movement(48):
        ((silhouette, camera),) = drawn(skeleton, generator, views=1)
        angles = (camera[f"{name}_deg"] for name in ("azimuth", "elevation", "roll"))
        rotation = camera_rotation(*angles)
        points_3d = skeleton @ rotation.T
        points = camera["scale"] * project(points_3d, camera["distance"])
        points += camera["offset_x"], camera["offset_y"]
        found.append((silhouette, points_3d, points))
    return found


def test_known_poses_in_new_views_are_recognised(
    toy_index: PoseIndex, new_views: list[View]
) -> None:
    """Mostly within 5 px, as the paper counts."""
    right = []
    for silhouette, _, points in new_views:
        found = best_hypotheses(toy_index, silhouette, 7)
        error_px = min(joint_error(one.points_2d, points) for one in found)
        right.append(error_px < RIGHT_BELOW_PX)
    assert np.mean(right) > 0.6


@pytest.mark.parametrize("number", QUERIES)
def test_own_silhouette_comes_first(toy_index: PoseIndex, number: int) -> None:
    best = best_hypotheses(toy_index, toy_index.silhouette(number), 3)[0]
    assert best.entry_id == number
    assert best.silhouette_distance == pytest.approx(0, abs=1e-3)
    assert best.reprojection_error_px == pytest.approx(0, abs=1e-6)
    # The pose of the entry, averaged with near neighbours of the same mode.
    assert joint_error(best.points_3d, toy_index.entry(number).points_3d) < 0.11


def assert_later_poses_are_new(found: list[PoseHypothesis]) -> None:
    """Hypotheses certainly of a later batch differ from all of the first batch."""
    poses = np.array([one.points_3d for one in found])
    for later in poses[2 * DEFAULT_HYPOTHESES :]:
        apart = mean_joint_distance(later[None], poses[:DEFAULT_HYPOTHESES])
        assert apart.min() >= MIN_NEW_POSE_M


@pytest.mark.parametrize("n", [1, 2, 7, 20])
@pytest.mark.parametrize("number", [5, 300])
def test_hypotheses_are_ascending_distinct_and_finite(
    toy_index: PoseIndex, number: int, n: int
) -> None:
    silhouette = toy_index.silhouette(number)
    found = best_hypotheses(toy_index, silhouette, n)
    assert len(found) == n
    distances = [h.distance for h in found]
    assert distances == sorted(distances)
    # A later batch is never reported to be nearer than an earlier one.
    assert all(h.distance >= h.silhouette_distance for h in found)
    first = found[:DEFAULT_HYPOTHESES]
    assert_allclose(
        [h.distance for h in first], np.maximum.accumulate([h.silhouette_distance for h in first])
    )
    assert len({(h.entry_id, h.mirrored) for h in first}) == len(first)
    assert_later_poses_are_new(found)
    joints = np.stack([h.points_3d[:JOINTS] for h in first])
    apart = np.sqrt(((joints[:, None] - joints[None]) ** 2).sum(axis=-1).mean(axis=-1))
    # Interpolation may bring distinct poses a little nearer.
    assert (apart[~np.eye(len(first), dtype=bool)] > 0.05).all()
    for hypothesis in found:
        for points in (hypothesis.points_3d, hypothesis.points_2d):
            assert np.isfinite(points).all()
        assert 0 <= hypothesis.confidence <= 1
        assert hypothesis.silhouette_distance >= 0
        assert hypothesis.reprojection_error_px >= 0
    again = best_hypotheses(toy_index, silhouette, n)
    assert [h.entry_id for h in again] == [h.entry_id for h in found]


def test_more_hypotheses_requested_than_exist(tiny_index: PoseIndex) -> None:
    found = best_hypotheses(tiny_index, tiny_index.silhouette(0), 10_000)
    assert 20 < len(found) <= 2 * len(tiny_index)  # each entry and its mirror image
    assert_later_poses_are_new(found)


def rolled_entries(index: PoseIndex) -> list[int]:
    """Some of the entries that were rolled upright."""
    return np.flatnonzero(np.abs(index.entries["roll_deg"]) > 30)[::17].tolist()


def roll_of(index: PoseIndex, number: int) -> float:
    return float(index.entries["roll_deg"][number])


def best_of(index: PoseIndex, silhouette: NDArray[np.uint8], roll_deg: float) -> PoseHypothesis:
    return match_silhouette(
        index, np.ascontiguousarray(silhouette), 3, roll_deg=roll_deg
    ).hypotheses[0]


class TestRolledQueries:
    """Silhouettes that were rotated upright."""

    def test_own_silhouette_comes_first(self, ground_index: PoseIndex) -> None:
        for number in rolled_entries(ground_index):
            roll_deg = roll_of(ground_index, number)
            found = best_of(ground_index, ground_index.silhouette(number), roll_deg)
            entry = ground_index.entry(number)
            assert (found.entry_id, found.mirrored) == (number, False)
            assert found.reprojection_error_px == pytest.approx(0, abs=1e-6)
            assert found.rotation_deg == pytest.approx(-roll_deg)
            assert found.label.roll_deg == pytest.approx(0, abs=1e-4)
            # In the picture as given, in space as seen without the roll.
            assert joint_error(found.points_2d, entry.points_normalised) < 3
            assert joint_error(found.points_3d, rotate_clockwise(entry.points_3d, -roll_deg)) < 0.1

    def test_upside_down_query_gives_the_same_pose(self, ground_index: PoseIndex) -> None:
        for number in rolled_entries(ground_index):
            roll_deg, silhouette = roll_of(ground_index, number), ground_index.silhouette(number)
            here = best_of(ground_index, silhouette, roll_deg)
            there = best_of(ground_index, silhouette[::-1, ::-1], roll_deg + 180)
            assert there.entry_id == here.entry_id
            assert there.posture == here.posture
            assert there.label.roll_deg == pytest.approx(here.label.roll_deg, abs=1e-4)
            assert joint_error(there.points_3d, here.points_3d) < 0.03
            frame = np.array(silhouette.shape[::-1]) - 1
            assert joint_error(frame - there.points_2d, here.points_2d) < 1


def likeliest(found: Match) -> PoseHypothesis:
    best = found.hypotheses[0]
    assert best.distance == min(one.distance for one in found.hypotheses)
    return best


def test_landmarks_reduce_the_error(toy_index: PoseIndex, new_views: list[View]) -> None:
    with_them: list[float] = []
    without: list[float] = []
    for silhouette, in_space, points in new_views[::4]:
        landmarks = landmarks_of(points, in_space)
        for found, errors in (
            (match_silhouette(toy_index, silhouette, 7), without),
            (match_landmarks(toy_index, silhouette, 7, landmarks), with_them),
        ):
            errors.append(joint_error(likeliest(found).points_2d, points))
    assert np.mean(with_them) < 0.6 * np.mean(without)


def test_alternatives_in_depth_have_the_joints_of_the_first_in_the_picture(
    toy_index: PoseIndex, new_views: list[View]
) -> None:
    for silhouette, in_space, points in new_views[::8]:
        landmarks = landmarks_of(points, in_space)
        found = match_landmarks(toy_index, silhouette, 14, landmarks).hypotheses
        first, *others = found[:DEFAULT_HYPOTHESES]
        alternatives = [one for one in others if one.in_depth]
        assert len(alternatives) >= 4 and not first.in_depth
        for one in found[1:]:
            same = np.array_equal(one.points_2d, first.points_2d)
            assert same == one.in_depth
        for one in alternatives:
            assert one.weight
            assert one.confidence < first.confidence
            assert one.reprojection_error_px == first.reprojection_error_px
            assert_allclose(one.points_3d[:, :2], first.points_3d[:, :2])
            assert joint_error(one.points_3d, first.points_3d) > 0.02
            entry, _ = points_of(toy_index, one.entry_id, mirrored=one.mirrored)
            own = rotate_clockwise(entry, one.rotation_deg)
            assert joint_error(one.points_3d, own) == pytest.approx(one.adjusted_m, abs=1e-6)


def test_hypotheses_move_along_with_landmarks(toy_index: PoseIndex, new_views: list[View]) -> None:
    """An arm is raised after the match; alternatives in depth stay those of the first."""
    stayed, along = list[float](), list[float]()
    wrist = POINT_NAMES.index("right_wrist")
    for silhouette, in_space, points in new_views[::8]:
        found = match_landmarks(toy_index, silhouette, 7, landmarks_of(points, in_space))
        points = points + np.array([4.0, -2.0])
        points[wrist, 1] -= 6
        moved = moved_along(found, landmarks_of(points, in_space), 0.0).hypotheses
        for before, after in zip(found.hypotheses, moved, strict=True):
            assert after.entry_id == before.entry_id and after.in_depth == before.in_depth
            if before.in_depth:
                assert_allclose(
                    after.points_3d - moved[0].points_3d,
                    before.points_3d - found.hypotheses[0].points_3d,
                    atol=1e-9,
                )
                assert np.array_equal(after.points_2d, moved[0].points_2d)
        stayed.append(joint_error(found.hypotheses[0].points_2d, points))
        along.append(joint_error(moved[0].points_2d, points))
    assert np.mean(along) < 0.6 * np.mean(stayed)


def test_the_rank_contradicts_neither_confidence_nor_weight(
    toy_index: PoseIndex, new_views: list[View]
) -> None:
    for silhouette, in_space, points in new_views[::8]:
        landmarks = landmarks_of(points, in_space)
        for found in (
            match_landmarks(toy_index, silhouette, 20, landmarks).hypotheses,
            match_silhouette(toy_index, silhouette, 20).hypotheses,
        ):
            assert (np.diff([one.confidence for one in found]) <= 0).all()
            assert (np.diff([one.distance for one in found]) >= 0).all()
        found = match_landmarks(toy_index, silhouette, 20, landmarks).hypotheses
        weights = np.array([one.weight for one in found], np.float64)
        assert (np.diff(weights) <= 0).all() and (weights >= 0).all()
        assert weights[:DEFAULT_HYPOTHESES].sum() == pytest.approx(1)
        fewer = match_landmarks(toy_index, silhouette, 3, landmarks).hypotheses
        assert [one.confidence for one in fewer] == [one.confidence for one in found[:7]]


@pytest.mark.parametrize("number", [40, 301])
def test_mirror_image_of_an_entry_is_found_with_its_landmarks(
    toy_index: PoseIndex, number: int
) -> None:
    points_3d, points = points_of(toy_index, number, mirrored=True)
    silhouette = np.ascontiguousarray(toy_index.silhouette(number)[:, ::-1])
    landmarks = landmarks_of(points, points_3d)
    best = likeliest(match_landmarks(toy_index, silhouette, 7, landmarks))
    assert (best.entry_id, best.mirrored) == (number, True)
    assert joint_error(best.points_2d, points) < 1
    assert joint_error(best.points_3d, points_3d) < 0.01
    assert best.reprojection_error_px == pytest.approx(0, abs=1e-6)


def test_landmarks_decide_between_left_and_right(
    toy_index: PoseIndex, new_views: list[View]
) -> None:
    correct = []
    for silhouette, in_space, points in new_views[::4]:
        for exchanged in (False, True):
            wanted, depth = (exchange_sides(p) if exchanged else p for p in (points, in_space))
            best = likeliest(match_landmarks(toy_index, silhouette, 7, landmarks_of(wanted, depth)))
            right, wrong = (
                joint_error(best.points_2d, p) for p in (wanted, exchange_sides(wanted))
            )
            correct.append(right <= wrong)
    assert np.mean(correct) > 0.9


@pytest.mark.parametrize("number", [40, 301, 500])
def test_partly_visible_person_is_placed_by_landmarks(toy_index: PoseIndex, number: int) -> None:
    """The silhouette is cut at the hips and fills the frame; landmarks show the scale."""
    entry = toy_index.entry(number)
    whole = toy_index.silhouette(number)
    hips = entry.points_normalised[side_rows("hip")]
    upper = whole.copy()
    upper[round(float(hips[:, 1].mean())) :] = 0
    cut, to_whole = rotate_silhouette(upper, 0.0)
    seen = (entry.points_normalised - to_whole[:, 2]) @ np.linalg.inv(to_whole[:, :2]).T
    landmarks = replace(landmarks_of(seen, entry.points_3d), whole=False)
    found = match_landmarks(toy_index, cut, 7, landmarks)
    *errors, error_facing_away = [joint_error(one.points_2d, seen) for one in found.hypotheses]
    assert max(errors) < 8
    assert error_facing_away < 16
    best = likeliest(found)
    assert joint_error(best.points_3d, entry.points_3d) < 0.15
    # The silhouette affects only the order.
    other = match_landmarks(toy_index, np.ones_like(cut), 7, landmarks)
    assert min(joint_error(one.points_3d, best.points_3d) for one in other.hypotheses) < 0.1


def test_twin_of_the_first_is_one_of_seven_unless_another_is_near(
    toy_index: PoseIndex, new_views: list[View]
) -> None:
    """The same outline from behind: in the place of the least likely, and without a vote."""
    offered = []
    for silhouette, _, _ in new_views[::4]:
        found = match_silhouette(toy_index, silhouette, 20)
        seven = found.hypotheses[:DEFAULT_HYPOTHESES]
        first, turned = seven[0], exchange_sides(seven[0].points_2d)
        twins = [one for one in seven if one.twin]
        near = [
            joint_error(one.points_2d, turned) < RIGHT_BELOW_PX
            for one in found.voters[: DEFAULT_HYPOTHESES - 1]
        ]
        assert len(twins) == (not any(near))
        assert not any(one.twin for one in [*found.voters, first])
        assert not any(one.twin for one in found.hypotheses[DEFAULT_HYPOTHESES:])
        offered.append(bool(twins))
        for twin in twins:
            assert_allclose(twin.points_2d, turned)
            assert_allclose(twin.points_3d, exchange_sides(first.points_3d) * [1, 1, -1])
            assert twin.distance >= first.distance
            assert twin.confidence <= first.confidence
            assert (twin.entry_id, twin.posture) == (first.entry_id, first.posture)
            # What the twin displaces is found again in a later batch.
            later = np.array([one.points_3d for one in found.hypotheses[DEFAULT_HYPOTHESES:]])
            assert mean_joint_distance(found.voters[-1].points_3d, later).min() < DISTINCT_M
    assert any(offered) and not all(offered)
