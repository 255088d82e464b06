"""Weighing hypotheses by what the photograph shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.weighing import best_with_twins, posterior, weigh_by_image, with_joints
from index.matching import Hypothesis
from index.skeleton import POINTS

probabilities = st.lists(st.floats(0, 1), min_size=1, max_size=12).map(np.array)


def likelihoods_like(confidences: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).lognormal(0, 1, len(confidences))


def hypothesis_like(confidence: float, **others: float) -> Hypothesis:
    points_3d = np.zeros((POINTS, 3))
    points_3d[[5, 11], 0], points_3d[[8, 15], 0] = 0.2, -0.2
    return Hypothesis(
        entry=0, mirrored=False, distance=1.0, reprojection_error_px=1.0, confidence=confidence,
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


class TestBestWithTwins:
    @given(scores=probabilities, n=st.integers(1, 8), seed=st.integers(0, 999))
    def test_takes_the_best_and_keeps_some_that_face_the_other_way(
        self, scores: NDArray[np.float64], n: int, seed: int
    ) -> None:
        azimuths = np.random.default_rng(seed).uniform(-180, 180, len(scores))
        chosen = best_with_twins(azimuths, scores, n)
        assert len(chosen) == len(set(chosen)) == min(n, len(scores))
        assert scores[chosen[0]] == scores.max()
        assert (np.diff(scores[chosen]) <= 0).all()
        front = np.cos(np.deg2rad(azimuths)) > 0
        others = np.flatnonzero(front != front[chosen[0]])
        kept = np.flatnonzero(front[chosen] != front[chosen[0]])
        if n > 1:
            assert len(kept) >= min(len(others), max(1, n // 3))
        # Nobody better was left out but for these.
        left_out = set(range(len(scores))) - set(chosen)
        for i in left_out:
            assert all(scores[i] <= scores[j] or j in others for j in chosen)


class TestWithJoints:
    @given(
        confidence=st.floats(0, 1), likely=st.floats(-60, 0), odds=st.floats(-40, 40),
        lean=st.sampled_from([-30.0, 0.0, 15.0]), head=st.floats(0.01, 6),
    )  # fmt: skip
    def test_is_a_probability_that_grows_with_each_evidence(
        self, confidence: float, likely: float, odds: float, lean: float, head: float
    ) -> None:
        some = {"log_likelihood": likely, "side_odds": odds, "lean_deg": lean}
        one = hypothesis_like(confidence, **some)
        better = [
            hypothesis_like(min(1.0, confidence + 0.05), **some),
            hypothesis_like(confidence, **{**some, "log_likelihood": likely / 2}),
            hypothesis_like(confidence, **{**some, "side_odds": odds + 5}),
            hypothesis_like(confidence, **{**some, "lean_deg": 0.0}),
        ]
        before = with_joints([one], np.array([head]))[0]
        assert 0 <= before <= 1
        for other in better:
            assert with_joints([other], np.array([head]))[0] >= before
        assert with_joints([one], np.array([2 * head]))[0] >= before

    def test_joints_reorder_and_the_head_need_not_be_seen(self) -> None:
        likely, unlikely = (
            hypothesis_like(c, log_likelihood=one) for c, one in ((0.3, -8.0), (0.5, -30.0))
        )
        weighed = weigh_by_image([unlikely, likely], None, 2)
        assert [one.log_likelihood for one in weighed.hypotheses] == [-8.0, -30.0]
        assert weighed.facing.evidence == "image"
