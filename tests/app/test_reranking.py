"""Hypotheses re-ranked by what the photograph shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.reranking import (
    PER_OPPOSITE_FACING,
    fused_confidences,
    fused_distances,
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
        points_normalised=np.zeros((POINTS, 2)), **others,
    )  # fmt: skip


class TestNearestOfBothFacings:
    @given(distances=ascending_distances, n=st.integers(1, 15), seed=st.integers(0, 999))
    def test_takes_the_nearest_and_keeps_some_that_face_the_other_way(
        self, distances: list[float], n: int, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        shuffled: NDArray[np.float64] = rng.permutation(np.array(distances))
        azimuths = rng.uniform(-180, 180, len(shuffled))
        chosen = nearest_of_both_facings(azimuths, shuffled, n)
        assert len(chosen) == len(set(chosen)) == min(n, len(shuffled))
        assert shuffled[chosen[0]] == shuffled.min()
        assert (np.diff(shuffled[chosen]) >= 0).all()
        front = np.cos(np.deg2rad(azimuths)) > 0
        others = set(np.flatnonzero(front != front[chosen[0]]).tolist())
        kept = others & set(chosen)
        if n > 1:
            assert len(kept) >= min(len(others), max(1, n // PER_OPPOSITE_FACING))
        # Nobody nearer was left out but for these.
        for i in set(range(len(shuffled))) - set(chosen):
            assert all(shuffled[i] >= shuffled[j] or j in others for j in chosen)


class TestFusedDistances:
    @given(
        distance=st.floats(0.01, 5), likely=st.floats(-60, 0), odds=st.floats(-40, 40),
        lean=st.sampled_from([-30.0, 0.0, 15.0]),
    )  # fmt: skip
    def test_each_evidence_brings_a_hypothesis_nearer_and_makes_it_surer(
        self, distance: float, likely: float, odds: float, lean: float
    ) -> None:
        hypotheses = {"log_likelihood": likely, "side_odds": odds, "tilt_deg": lean}
        before = fused_distances([hypothesis_like(distance, **hypotheses)])
        assert 0 <= fused_confidences(before)[0] <= 1
        for better in (
            hypothesis_like(0.9 * distance, **hypotheses),
            hypothesis_like(distance, **{**hypotheses, "log_likelihood": likely / 2}),
            hypothesis_like(distance, **{**hypotheses, "side_odds": odds + 5}),
            hypothesis_like(distance, **{**hypotheses, "tilt_deg": 0.0}),
        ):
            after = fused_distances([better])
            assert after[0] <= before[0]
            assert fused_confidences(after)[0] >= fused_confidences(before)[0]

    @given(distances=ascending_distances)
    def test_a_photograph_that_shows_nothing_changes_nothing(self, distances: list[float]) -> None:
        hypotheses = [hypothesis_like(distance) for distance in distances]
        assert fused_distances(hypotheses) == pytest.approx(distances)

    @given(distance=st.floats(0.01, 5), lean=st.floats(0, 60))
    def test_either_tilt_counts_alike(self, distance: float, lean: float) -> None:
        left, right = (hypothesis_like(distance, tilt_deg=s * lean) for s in (-1, 1))
        both = fused_distances([left, right])
        assert both[0] == pytest.approx(both[1])


class TestRankBySilhouette:
    @given(distances=ascending_distances, n=st.integers(1, 15))
    def test_leaves_what_the_silhouette_says(self, distances: list[float], n: int) -> None:
        hypotheses = [
            hypothesis_like(distance, confidence=1 / (1 + distance)) for distance in distances
        ]
        ranked = rank_by_silhouette(hypotheses, n)
        assert ranked.hypotheses == tuple(hypotheses[:n])
        assert list(ranked.distances) == distances[:n]
        assert list(ranked.confidences) == [hypothesis.confidence for hypothesis in hypotheses[:n]]
        assert ranked.facing.evidence == "none"

    def test_the_facing_is_that_of_those_that_are_left(self) -> None:
        front = hypothesis_like(1, confidence=0.6)
        back = hypothesis_like(2, front=False, confidence=0.2)
        assert rank_by_silhouette([front, back], 2).facing.front_probability == pytest.approx(0.75)
        assert rank_by_silhouette([front, back], 1).facing.front_probability == pytest.approx(1)


class TestRankByKeypoints:
    def test_keypoints_reorder(self) -> None:
        likely, unlikely = (
            hypothesis_like(distance, log_likelihood=likelihood)
            for distance, likelihood in ((0.8, -8.0), (0.5, -30.0))
        )
        ranked = rank_by_keypoints([unlikely, likely], 2)
        assert [hypothesis.log_likelihood for hypothesis in ranked.hypotheses] == [-8.0, -30.0]
        assert list(ranked.distances) == sorted(ranked.distances)
        assert list(ranked.confidences) == sorted(ranked.confidences, reverse=True)
        assert ranked.facing.evidence == "image"

    @given(odds=st.floats(0.5, 30))
    def test_sides_tell_the_facing(self, odds: float) -> None:
        """The same pose, once with its sides exchanged."""
        front = hypothesis_like(1, log_likelihood=-4, side_odds=odds)
        back = hypothesis_like(1, front=False, log_likelihood=-4, side_odds=-odds)
        for hypotheses in ([front, back], [back, front]):
            ranked = rank_by_keypoints(hypotheses, 2)
            assert ranked.hypotheses[0] is front
            assert ranked.facing.front_probability > 0.5

    @given(distances=ascending_distances, n=st.integers(1, 15), seed=st.integers(0, 999))
    def test_as_many_as_asked_in_ascending_distance(
        self, distances: list[float], n: int, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        hypotheses = [
            hypothesis_like(
                distance, front=bool(rng.integers(2)), log_likelihood=-float(rng.exponential(9)),
                side_odds=float(rng.normal(0, 9)),
            )
            for distance in distances
        ]  # fmt: skip
        ranked = rank_by_keypoints(hypotheses, n)
        assert len(ranked.hypotheses) == len(ranked.distances) == min(n, len(hypotheses))
        assert list(ranked.distances) == sorted(ranked.distances)
        assert ranked.distances[0] == pytest.approx(fused_distances(hypotheses).min())
        assert 0 <= ranked.facing.front_probability <= 1
