"""Probabilities that hypotheses are right: by a calibration that survives the manifest, and by
landmarks.
"""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from index.confidence import FEATURES, Calibration, fused_confidences

COUNT = len(FEATURES)


def some_features(rows: int) -> np.ndarray:
    return np.random.default_rng(0).normal(0, 3, (rows, COUNT))


def test_round_trip_through_json() -> None:
    calibration = Calibration(tuple(np.linspace(-1, 1, COUNT).tolist()), 0.25)
    back = Calibration.restore(json.loads(json.dumps(calibration.parameters())))
    assert back == calibration
    assert_array_equal(
        back.probability(some_features(9)), calibration.probability(some_features(9))
    )


def test_probabilities_of_extreme_features() -> None:
    calibration = Calibration((1e6,) * COUNT, -3.0)
    probability = calibration.probability(some_features(50))
    assert np.isfinite(probability).all()
    assert ((probability >= 0) & (probability <= 1)).all()


def test_calibration_over_other_features_is_refused() -> None:
    parameters = {"features": ["shoe_size"], "weights": [1.0], "bias": 0.0}
    with pytest.raises(ValueError, match="got one over shoe_size"):
        Calibration.restore(parameters)
    with pytest.raises(ValueError, match="got one over nothing"):
        Calibration.restore({})


@pytest.mark.parametrize("weights", [(1.0,), (float("nan"),) * COUNT, (1.0,) * (COUNT + 1)])
def test_invalid_weights_are_refused(weights: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="finite weights and a finite bias"):
        Calibration(weights, 0.0)


@given(distances=st.lists(st.floats(0, 1e4), min_size=2, max_size=20).map(sorted))
def test_confidence_with_landmarks_falls_with_the_distance(distances: list[float]) -> None:
    confidences = fused_confidences(np.array(distances), np.zeros(len(distances)))
    assert ((confidences > 0) & (confidences < 1)).all()
    assert (np.diff(confidences) <= 0).all()
