"""Entries nearest to keypoints: the same as by solving for each of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.keypoint_search import ROLL_PX, SEARCHED, KeypointSearch
from index.keypoints import Keypoints
from index.skeleton import POINT_NAMES, mirror_normalised
from index.store import PoseIndex

# Sums of squares of pixels in single precision: sums near 0 err by up to about 0.01.
ATOL = 0.1


def turned(points: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """Points turned clockwise as seen: y is down."""
    cosine, sine = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def upright_points(
    index: PoseIndex, number: int | NDArray[np.int64], *, mirrored: bool = False
) -> NDArray[np.float64]:
    """Points ``(..., 24, 2)`` of entries as cameras that are not rolled see them."""
    numbers = np.atleast_1d(number)
    points = index.points(numbers)[1]
    rolls = index.roll_deg(numbers, np.full(len(numbers), mirrored))
    if mirrored:
        points = mirror_normalised(points)
    upright = np.stack([turned(*pair) for pair in zip(points, -rolls, strict=True)])
    return upright.reshape(*np.shape(number), *points.shape[1:])


def keypoints_of(points: NDArray[np.float64], seed: int = 0, *left_out: str) -> Keypoints:
    rows = [row for row in SEARCHED if POINT_NAMES[row] not in left_out]
    scores = np.random.default_rng(seed).uniform(0.2, 1, len(rows))
    return Keypoints(tuple(rows), points[rows], scores)


def solved(
    keypoints: Keypoints, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Residuals, turns counted, and turns of skeletons ``(K, 24, 2)``, each by least squares.

    x' = a x - b y + s and y' = b x + a y + t, with the unknowns a, b, s and t.
    """
    weights = np.sqrt(keypoints.scores / keypoints.scores.sum())
    wanted = (keypoints.positions * weights[:, None]).T.ravel()
    residuals, rolls = [], []
    for x, y in points[:, list(keypoints.rows)].transpose(0, 2, 1):
        one, none = np.ones_like(x), np.zeros_like(x)
        matrix = np.concatenate([np.stack([x, -y, one, none], 1), np.stack([y, x, none, one], 1)])
        matrix *= np.tile(weights, 2)[:, None]
        found = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
        rolls.append(np.rad2deg(np.arctan2(found[1], found[0])))
        turn = ROLL_PX**2 * (1 - np.cos(np.deg2rad(rolls[-1])))
        residuals.append(np.sqrt(((matrix @ found - wanted) ** 2).sum() + turn))
    return np.array(residuals), np.array(rolls)


@pytest.mark.parametrize("number", [5, 130, 400])
@pytest.mark.parametrize("left_out", [(), ("left_wrist", "nose", "right_ankle")])
def test_equals_least_squares(toy_index: PoseIndex, number: int, left_out: tuple[str, ...]) -> None:
    everything = np.arange(len(toy_index))
    every, images = (upright_points(toy_index, everything, mirrored=m) for m in (False, True))
    rng = np.random.default_rng(number)
    seen = 1.7 * turned(every[number] + rng.normal(0, 3, (24, 2)), 25) + (9, -30)
    keypoints = keypoints_of(seen, number, *left_out)
    found = toy_index.keypoint_search.nearest(keypoints, 40)
    straight, mirrored = (solved(keypoints, p) for p in (every, images))
    residuals = np.concatenate([straight[0], mirrored[0]])
    assert_allclose(found.residual_px, np.sort(residuals)[:40], atol=ATOL)
    rolls = np.concatenate([straight[1], mirrored[1]])
    position = found.numbers + len(toy_index) * found.mirrored
    assert_allclose(found.residual_px, residuals[position], atol=ATOL)
    assert_allclose((found.roll_deg - rolls[position] + 180) % 360, 180, atol=0.1)


@pytest.mark.parametrize("number", range(0, 576, 97))
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("roll", [0.0, 20.0, -35.0])
def test_an_entry_that_is_turned_scaled_and_moved_is_found(
    toy_index: PoseIndex, number: int, mirrored: bool, roll: float
) -> None:
    points = upright_points(toy_index, number, mirrored=mirrored)
    found = toy_index.keypoint_search.nearest(keypoints_of(0.6 * turned(points, roll) + 17), 5)
    counted = ROLL_PX * np.sqrt(1 - np.cos(np.deg2rad(roll)))
    if roll == 0:
        assert (found.numbers[0], found.mirrored[0]) == (number, mirrored)
    near = (found.numbers == number) & (found.mirrored == mirrored)
    assert near.any()
    assert found.residual_px[near] == pytest.approx([counted], abs=ATOL)
    assert found.roll_deg[near] == pytest.approx([roll], abs=0.1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_entries_rolled_to_stand_are_searched_as_they_lie(
    ground_index: PoseIndex, mirrored: bool
) -> None:
    rolled = np.flatnonzero(np.abs(ground_index.entries["roll_deg"]) > 30)[::40]
    for number in rolled:
        points = upright_points(ground_index, number, mirrored=mirrored)
        found = ground_index.keypoint_search.nearest(keypoints_of(points), 1)
        assert (found.numbers[0], found.mirrored[0]) == (number, mirrored)
        assert found.roll_deg[0] == pytest.approx(0, abs=0.1)


def test_people_upright_come_before_people_who_lean_as_far(toy_index: PoseIndex) -> None:
    points = toy_index.entry(40).points_normalised
    both = np.stack([turned(points, -50), points])[:, SEARCHED]
    found = KeypointSearch(both).nearest(keypoints_of(points), 2)
    assert found.numbers.tolist()[0] == 1
    assert not found.mirrored[0]


def test_points_beside_those_searched_are_left_out(toy_index: PoseIndex) -> None:
    points = toy_index.entry(7).points_normalised
    plain = keypoints_of(points)
    toe = POINT_NAMES.index("left_toe")
    more = Keypoints(
        (*plain.rows, toe), np.vstack([plain.positions, [[900, 900]]]), np.append(plain.scores, 1.0)
    )
    ours, theirs = (toy_index.keypoint_search.nearest(one, 9) for one in (more, plain))
    assert ours.numbers.tolist() == theirs.numbers.tolist()
    assert_allclose(ours.residual_px, theirs.residual_px, atol=ATOL)


def test_no_more_than_all_entries_and_their_mirror_images(toy_index: PoseIndex) -> None:
    found = toy_index.keypoint_search.nearest(
        keypoints_of(toy_index.entry(0).points_normalised), 10**6
    )
    assert len(found.numbers) == 2 * len(toy_index) == 2 * len(toy_index.keypoint_search)
    assert len(set(zip(found.numbers.tolist(), found.mirrored.tolist(), strict=True))) == len(
        found.numbers
    )
    assert (np.diff(found.residual_px) >= -1e-6).all()


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected points of shape \(E, 10, 2\)"):
        KeypointSearch(np.zeros((4, 9, 2)))
