"""Weighing hypotheses by what the photograph shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.weighing import (
    distances_from_all,
    nearest_with_twins,
    posterior,
    weigh,
    weigh_by_image,
    with_joints,
)
from index.matching import Hypothesis
from index.skeleton import POINTS

probabilities = st.lists(st.floats(0, 1), min_size=1, max_size=12).map(np.array)


def likelihoods_like(confidences: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).lognormal(0, 1, len(confidences))


def hypothesis_like(distance: float = 1.0, **others: float) -> Hypothesis:
    points_3d = np.zeros((POINTS, 3))
    points_3d[[5, 11], 0], points_3d[[8, 15], 0] = 0.2, -0.2
    return Hypothesis(
        entry=0, mirrored=False, distance=distance, reprojection_error_px=1.0, confidence=0.5,
        points_3d=points_3d, points_normalised=np.zeros((POINTS, 2)), **others,
    )  # fmt: skip


class TestPosterior:
    @given(confidences=probabilities)
    def test_stays_where_all_are_as_likely_as_nothing_seen(
        self, confidences: NDArray[np.float64]
    ) -> None:
        after = posterior(confidences, np.ones(len(confidences)))
        assert after == pytest.approx(confidences, abs=2e-6)

    @given(confidences=probabilities, seed=st.integers(0, 999))
    def test_is_a_probability(self, confidences: NDArray[np.float64], seed: int) -> None:
        after = posterior(confidences, likelihoods_like(confidences, seed))
        assert ((after >= 0) & (after <= 1)).all()

    @given(confidences=probabilities, seed=st.integers(0, 999))
    def test_grows_with_its_own_likelihood(
        self, confidences: NDArray[np.float64], seed: int
    ) -> None:
        likelihoods = likelihoods_like(confidences, seed)
        more = likelihoods.copy()
        more[0] *= 2
        assert posterior(confidences, more)[0] >= posterior(confidences, likelihoods)[0]


class TestNearestWithTwins:
    @given(distances=probabilities, n=st.integers(1, 8), seed=st.integers(0, 999))
    def test_takes_the_nearest_and_keeps_some_that_face_the_other_way(
        self, distances: NDArray[np.float64], n: int, seed: int
    ) -> None:
        azimuths = np.random.default_rng(seed).uniform(-180, 180, len(distances))
        chosen = nearest_with_twins(azimuths, distances, n)
        assert len(chosen) == len(set(chosen)) == min(n, len(distances))
        assert distances[chosen[0]] == distances.min()
        assert (np.diff(distances[chosen]) >= 0).all()
        front = np.cos(np.deg2rad(azimuths)) > 0
        others = np.flatnonzero(front != front[chosen[0]])
        kept = np.flatnonzero(front[chosen] != front[chosen[0]])
        if n > 1:
            assert len(kept) >= min(len(others), max(1, n // 3))
        # Nobody nearer was left out but for these.
        left_out = set(range(len(distances))) - set(chosen)
        for i in left_out:
            assert all(distances[i] >= distances[j] or j in others for j in chosen)


class TestDistancesFromAll:
    @given(
        distance=st.floats(0.01, 5), likely=st.floats(-60, 0), odds=st.floats(-40, 40),
        lean=st.sampled_from([-30.0, 0.0, 15.0]), head=st.floats(0.01, 6),
    )  # fmt: skip
    def test_each_evidence_brings_a_hypothesis_nearer_and_makes_it_surer(
        self, distance: float, likely: float, odds: float, lean: float, head: float
    ) -> None:
        some = {"log_likelihood": likely, "side_odds": odds, "lean_deg": lean}
        one = hypothesis_like(distance, **some)
        better = [
            hypothesis_like(0.9 * distance, **some),
            hypothesis_like(distance, **{**some, "log_likelihood": likely / 2}),
            hypothesis_like(distance, **{**some, "side_odds": odds + 5}),
            hypothesis_like(distance, **{**some, "lean_deg": 0.0}),
        ]
        before = distances_from_all([one], np.array([head]))
        assert 0 <= with_joints(before)[0] <= 1
        for other, seen in (*((other, head) for other in better), (one, 2 * head)):
            after = distances_from_all([other], np.array([seen]))
            assert after[0] <= before[0]
            assert with_joints(after)[0] >= with_joints(before)[0]

    @given(distances=st.lists(st.floats(0, 5), min_size=1, max_size=9))
    def test_a_photograph_that_shows_nothing_changes_nothing(self, distances: list[float]) -> None:
        some = [hypothesis_like(one) for one in sorted(distances)]
        assert distances_from_all(some, np.ones(len(some))) == pytest.approx(sorted(distances))
        assert list(weigh(some, 7).distances) == sorted(distances)[:7]


def test_joints_reorder_and_the_head_need_not_be_seen() -> None:
    likely, unlikely = (
        hypothesis_like(distance, log_likelihood=one)
        for distance, one in ((0.8, -8.0), (0.5, -30.0))
    )
    weighed = weigh_by_image([unlikely, likely], None, 2)
    assert [one.log_likelihood for one in weighed.hypotheses] == [-8.0, -30.0]
    assert list(weighed.distances) == sorted(weighed.distances)
    assert weighed.facing.evidence == "image"
