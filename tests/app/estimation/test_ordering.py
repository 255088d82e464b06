"""Hypotheses re-ranked by what the photograph shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.estimation.ordering import (
    PER_OPPOSITE_FACING,
    fused_confidences,
    nearest_of_both_facings,
    rank_by_keypoints,
    rank_by_silhouette,
)
from index.matching import Hypothesis
from index.skeleton import POINT_NAMES, POINTS

ascending_distances = st.lists(st.floats(0, 5), min_size=1, max_size=12).map(sorted)


def hypothesis_like(distance: float = 1.0, *, front: bool = True, **others: float) -> Hypothesis:
    """One whose left is on the right of the picture, as that of people who face the camera."""
    points_3d = np.zeros((POINTS, 3))
    for side, sign in (("left", 1), ("right", -1)):
        for joint in ("shoulder", "hip"):
            row = POINT_NAMES.index(f"{side}_{joint}")
            points_3d[row, 0] = 0.2 * sign * (1 if front else -1)
            points_3d[row, 1] = -0.5 if joint == "shoulder" else 0.0
    return Hypothesis(
        entry=0, mirrored=False, distance=distance, reprojection_error_px=1.0,
        confidence=others.pop("confidence", 0.5), points_3d=points_3d,
        fused_distance=others.pop("fused_distance", distance),
        points_normalised=np.zeros((POINTS, 2)), **others,
    )  # fmt: skip


class TestNearestOfBothFacings:
    @given(distances=ascending_distances, n=st.integers(1, 15), seed=st.integers(0, 999))
    def test_takes_the_nearest_and_of_every_seven_one_that_faces_the_other_way(
        self, distances: list[float], n: int, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        shuffled: NDArray[np.float64] = rng.permutation(np.array(distances))
        azimuths = rng.uniform(-180, 180, len(shuffled))
        chosen = nearest_of_both_facings(azimuths, shuffled, n)
        assert len(chosen) == len(set(chosen)) == min(n, len(shuffled))
        assert shuffled[chosen[0]] == shuffled.min()
        front = np.cos(np.deg2rad(azimuths)) > 0
        opposite = front != front[chosen[0]]
        for facing in (opposite, ~opposite):
            of_it = [i for i in chosen if facing[i]]
            assert shuffled[of_it].tolist() == sorted(shuffled[facing])[: len(of_it)]
        for sevenths in range(1, n // PER_OPPOSITE_FACING + 1):
            first = chosen[: sevenths * PER_OPPOSITE_FACING]
            assert opposite[first].sum() >= min(sevenths, opposite.sum())
        for rank, i in enumerate(chosen, start=1):
            nearer = set(range(len(shuffled))) - set(chosen[:rank])
            assert rank % PER_OPPOSITE_FACING == 0 or all(
                shuffled[i] <= shuffled[j] for j in nearer
            )

    @given(
        distances=ascending_distances, n=st.integers(1, 15), k=st.integers(1, 15),
        seed=st.integers(0, 999),
    )  # fmt: skip
    def test_the_first_are_those_that_are_chosen_where_fewer_are_asked_for(
        self, distances: list[float], n: int, k: int, seed: int
    ) -> None:
        azimuths = np.random.default_rng(seed).uniform(-180, 180, len(distances))
        fewer, more = sorted((k, n))
        chosen = nearest_of_both_facings(azimuths, np.array(distances), more)
        assert chosen[:fewer] == nearest_of_both_facings(azimuths, np.array(distances), fewer)


class TestConfidences:
    @given(distances=st.lists(st.floats(0, 1e4), min_size=2, max_size=20).map(sorted))
    def test_the_nearer_the_surer(self, distances: list[float]) -> None:
        confidences = fused_confidences(np.array(distances), np.zeros(len(distances)))
        assert ((confidences >= 0) & (confidences <= 1)).all()
        assert (np.diff(confidences) <= 0).all()


class TestRankBySilhouette:
    @given(distances=st.lists(st.floats(0, 5), min_size=1, max_size=30))
    def test_distances_ascend_where_a_later_batch_is_nearer(self, distances: list[float]) -> None:
        ranked = rank_by_silhouette([hypothesis_like(one) for one in distances], len(distances))
        assert list(ranked.distances) == sorted(ranked.distances)
        assert [hypothesis.distance for hypothesis in ranked.hypotheses] == distances
        assert all(one >= own for one, own in zip(ranked.distances, distances, strict=True))
        assert set(ranked.distances) <= set(distances)

    def test_the_facing_is_that_of_those_that_are_left(self) -> None:
        front = hypothesis_like(1, confidence=0.6)
        back = hypothesis_like(2, front=False, confidence=0.2)
        assert rank_by_silhouette([front, back], 2).facing.front_probability == pytest.approx(0.75)
        assert rank_by_silhouette([front, back], 1).facing.front_probability == pytest.approx(1)


class TestRankByKeypoints:
    def test_the_distance_of_both_kinds_of_evidence_decides(self) -> None:
        near, far = (
            hypothesis_like(distance, fused_distance=fused)
            for distance, fused in ((0.8, 0.3), (0.5, 2.0))
        )
        ranked = rank_by_keypoints([far, near], 2)
        assert ranked.hypotheses == (near, far)
        assert ranked.distances == (0.3, 2.0)
        assert ranked.confidences == tuple(fused_confidences(np.array([0.3, 2.0]), np.zeros(2)))
        assert ranked.facing.evidence == "image"

    @given(nearer=st.floats(0.1, 10), farther=st.floats(1.1, 100))
    def test_the_surer_hypotheses_tell_the_facing(self, nearer: float, farther: float) -> None:
        front = hypothesis_like(fused_distance=nearer)
        back = hypothesis_like(front=False, fused_distance=nearer * farther)
        for hypotheses in ([front, back], [back, front]):
            ranked = rank_by_keypoints(hypotheses, 2)
            assert ranked.hypotheses[0] is front
            assert ranked.facing.front_probability > 0.5

    def test_later_hypotheses_change_no_facing(self) -> None:
        first = [hypothesis_like(fused_distance=one, front=one < 2) for one in (1.0, 2.0)]
        later = hypothesis_like(front=False, fused_distance=2.0)
        for rank in (rank_by_keypoints, rank_by_silhouette):
            assert rank([*first, later], 3, voters=2).facing == rank(first, 2).facing
            assert rank([*first, later], 3).facing != rank(first, 2).facing

    @given(distances=ascending_distances, n=st.integers(1, 15), seed=st.integers(0, 999))
    def test_as_many_as_asked_in_ascending_distance(
        self, distances: list[float], n: int, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        hypotheses = [
            hypothesis_like(fused_distance=distance, front=bool(rng.integers(2)))
            for distance in distances
        ]
        ranked = rank_by_keypoints(hypotheses, n)
        assert len(ranked.hypotheses) == len(ranked.distances) == min(n, len(hypotheses))
        assert list(ranked.distances) == sorted(ranked.distances)
        assert ranked.distances[0] == min(distances)
        assert 0 <= ranked.facing.front_probability <= 1
