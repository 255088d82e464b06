"""Probabilities and log odds are each other's inverse, and finite."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from app.networks.probabilities import log_odds, probability_of, softmax


@given(st.floats(1e-3, 1 - 1e-3))
def test_log_odds_and_probability_are_inverse(probability: float) -> None:
    assert probability_of(log_odds(probability)) == pytest.approx(probability)
    assert log_odds(1 - probability) == pytest.approx(-log_odds(probability), abs=1e-9)


def test_probabilities_sum_to_one_however_large_the_scores() -> None:
    given = softmax(np.array([[1e4, 0.0, -1e4], [1.0, 1.0, 1.0]]))
    assert_allclose(given.sum(axis=1), 1)
    assert_allclose(given[1], 1 / 3)
