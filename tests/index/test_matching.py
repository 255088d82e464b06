"""What a caller of ``match`` may rely on, whatever ranks the hypotheses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.learn import view_joints
from index.build.poses import Poses
from index.build.simulate import Simulation, simulate
from index.confidence import RIGHT_BELOW_PX
from index.matching import match, outline_distances
from index.skeleton import JOINTS, POINTS, mirror_3d, mirror_normalised
from index.store import PoseIndex

QUERIES = range(0, 576, 61)


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
            for h in match(toy_index, silhouette, 7)
        )
        for silhouette, joints in zip(strangers.silhouettes(slice(None)), truth, strict=True)
    ]
    assert np.mean(np.array(errors) < RIGHT_BELOW_PX) > 0.6


@pytest.mark.parametrize("number", QUERIES)
def test_own_silhouette_comes_first(toy_index: PoseIndex, number: int) -> None:
    best = match(toy_index, toy_index.silhouette(number), 3)[0]
    assert best.entry == number
    assert best.distance == pytest.approx(0, abs=1e-3)
    assert best.reprojection_error_px == pytest.approx(0, abs=1e-6)
    # Its pose, but for averaging with near neighbours of the same mode.
    apart = np.linalg.norm(best.points_3d - toy_index.entry(number).points_3d, axis=-1)
    assert apart.mean() < 0.11


@pytest.mark.parametrize("number", QUERIES)
def test_mirrored_silhouette_gives_mirrored_answers(toy_index: PoseIndex, number: int) -> None:
    silhouette = toy_index.silhouette(number)
    there, here = (match(toy_index, s, 3) for s in (silhouette[:, ::-1], silhouette))
    # Where two candidates tie, rounding may choose another centre: the best one must agree.
    assert there[0].entry == here[0].entry
    assert there[0].mirrored != here[0].mirrored
    assert there[0].confidence == pytest.approx(here[0].confidence, abs=1e-3)
    assert_allclose(there[0].points_3d, mirror_3d(here[0].points_3d), atol=1e-3)
    assert_allclose(
        there[0].points_normalised, mirror_normalised(here[0].points_normalised), atol=0.05
    )


@pytest.mark.parametrize("n", [1, 2, 7, 20])
@pytest.mark.parametrize("number", [5, 300])
class TestHypotheses:
    def test_are_as_many_as_asked(self, toy_index: PoseIndex, number: int, n: int) -> None:
        assert len(match(toy_index, toy_index.silhouette(number), n)) == n

    def test_ascend_in_distance(self, toy_index: PoseIndex, number: int, n: int) -> None:
        found = match(toy_index, toy_index.silhouette(number), n)
        distances = [h.distance for h in found]
        assert distances == sorted(distances)

    def test_are_distinct_entries(self, toy_index: PoseIndex, number: int, n: int) -> None:
        found = match(toy_index, toy_index.silhouette(number), n)
        assert len({(h.entry, h.mirrored) for h in found}) == n

    def test_are_finite_and_in_range(self, toy_index: PoseIndex, number: int, n: int) -> None:
        for hypothesis in match(toy_index, toy_index.silhouette(number), n):
            assert hypothesis.mirrored in (False, True)
            assert hypothesis.points_3d.shape == (POINTS, 3)
            assert hypothesis.points_normalised.shape == (POINTS, 2)
            assert np.isfinite(hypothesis.points_3d).all()
            assert np.isfinite(hypothesis.points_normalised).all()
            assert 0 <= hypothesis.confidence <= 1
            assert 0 <= hypothesis.entry < len(toy_index)
            assert hypothesis.distance >= 0
            assert hypothesis.reprojection_error_px >= 0

    def test_do_not_depend_on_chance(self, toy_index: PoseIndex, number: int, n: int) -> None:
        silhouette = toy_index.silhouette(number)
        one, other = (match(toy_index, silhouette, n) for _ in range(2))
        assert [h.entry for h in one] == [h.entry for h in other]


def smallest_gap_m(index: PoseIndex, silhouette: NDArray[np.uint8]) -> float:
    """Root mean square joint distance of the two most alike of four hypotheses, metres."""
    joints = np.stack([h.points_3d[:JOINTS] for h in match(index, silhouette, 4)])
    squared = ((joints[:, None] - joints[None]) ** 2).sum(axis=-1)
    apart = np.sqrt(squared.mean(axis=-1))
    return float(apart[~np.eye(4, dtype=bool)].min())


@pytest.mark.parametrize("known", [True, False])
def test_hypotheses_are_distinct_poses(
    toy_index: PoseIndex, strangers: Simulation, known: bool
) -> None:
    """Not seven neighbours of one frame; interpolation may bring them a little nearer."""
    asked = toy_index.silhouettes(QUERIES) if known else strangers.silhouettes(slice(0, 12))
    for silhouette in asked:
        assert smallest_gap_m(toy_index, silhouette) > 0.05


def test_asks_for_more_than_there_is(toy_index: PoseIndex) -> None:
    found = match(toy_index, toy_index.silhouette(0), 10_000)
    assert 0 < len(found) <= len(toy_index)
    assert len({(h.entry, h.mirrored) for h in found}) == len(found)


@pytest.mark.parametrize("drawn", ["full", "dot"])
def test_answers_degenerate_silhouettes(toy_index: PoseIndex, drawn: str) -> None:
    silhouette = np.zeros((128, 48), np.uint8)
    silhouette[(slice(None), slice(None)) if drawn == "full" else (60, 20)] = 1
    for hypothesis in match(toy_index, silhouette, 2):
        assert np.isfinite([hypothesis.distance, hypothesis.confidence]).all()
        assert np.isfinite(hypothesis.reprojection_error_px)


class TestOutlineDistances:
    square = np.zeros((128, 48), np.uint8)
    square[40:80, 10:30] = 1

    def test_zero_for_the_same(self) -> None:
        assert outline_distances(self.square, self.square[None])[0] == 0

    def test_symmetric(self) -> None:
        other = np.roll(self.square, 5, axis=0)
        other[60:70] = 0
        there = outline_distances(self.square, other[None])[0]
        back = outline_distances(other, self.square[None])[0]
        assert there == pytest.approx(back)
        assert there > 0

    def test_grows_with_a_shift_and_stays_below_it(self) -> None:
        shifts = np.arange(1, 15)
        moved = np.stack([np.roll(self.square, shift, axis=1) for shift in shifts])
        distances = outline_distances(self.square, moved)
        assert (np.diff(distances) > 0).all()
        # Every outline pixel has its own image at the distance of the shift.
        assert (distances <= shifts + 0.1).all()

    def test_frame_within_a_frame(self) -> None:
        # Concentric squares 4 px apart: sides are 4 px away, only corners farther.
        inner = np.zeros_like(self.square)
        inner[44:76, 14:26] = 1
        assert_allclose(outline_distances(self.square, inner[None]), 4, atol=0.3)

    def test_batch_equals_one_by_one(self) -> None:
        others = np.stack([np.roll(self.square, s, axis=0) for s in (0, 3, 9)])
        single = [outline_distances(self.square, other[None])[0] for other in others]
        assert_allclose(outline_distances(self.square, others), single)
