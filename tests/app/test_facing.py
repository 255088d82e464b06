"""Weighing hypotheses by what the photograph shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.facing import azimuth_deg, best_with_twin, front_share, posterior
from index.skeleton import camera_rotation

probabilities = st.lists(st.floats(0, 1), min_size=1, max_size=12).map(np.array)


def likelihoods_like(confidences: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).lognormal(0, 1, len(confidences))


@pytest.mark.parametrize("azimuth", [-170.0, -90.0, -30.0, 0.0, 45.0, 90.0, 179.0])
# From above, depth is foreshortened.
@pytest.mark.parametrize(("elevation", "atol"), [(0.0, 1e-9), (30.0, 5.0)])
def test_azimuth_is_that_of_the_camera(azimuth: float, elevation: float, atol: float) -> None:
    body = np.zeros((24, 3))
    body[[5, 11], 0], body[[8, 15], 0] = 0.2, -0.2  # shoulders and hips, to the left and right
    body[[5, 8], 1] = 0.5
    seen = azimuth_deg(body @ camera_rotation(azimuth, elevation).T)
    assert (seen - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=atol)


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


class TestBestWithTwin:
    @given(scores=probabilities, n=st.integers(1, 8), seed=st.integers(0, 999))
    def test_takes_the_best_and_keeps_one_that_faces_the_other_way(
        self, scores: NDArray[np.float64], n: int, seed: int
    ) -> None:
        azimuths = np.random.default_rng(seed).uniform(-180, 180, len(scores))
        chosen = best_with_twin(azimuths, scores, n)
        assert len(chosen) == len(set(chosen)) == min(n, len(scores))
        assert scores[chosen[0]] == scores.max()
        assert (np.diff(scores[chosen]) <= 0).all()
        front = np.cos(np.deg2rad(azimuths)) > 0
        if n > 1 and 0 < front.sum() < len(front):
            assert 0 < front[chosen].sum() < len(chosen)


def test_front_share_is_that_of_the_confidence() -> None:
    azimuths, confidences = np.array([0.0, 60.0, 120.0, 180.0]), np.array([0.5, 0.1, 0.2, 0.2])
    assert front_share(azimuths, confidences) == pytest.approx(0.6)
    assert front_share(azimuths, np.zeros(4)) == pytest.approx(0.5)
