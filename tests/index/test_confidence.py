"""Probabilities that hypotheses are right: of silhouettes alone, by a calibration that survives the
manifest, and with landmarks.
"""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from index.confidence import (
    FEATURES,
    LANDMARK_CONFIDENCE,
    LANDMARK_FEATURES,
    RERANKING_FEATURES,
    Calibration,
    signs,
)

COUNT = len(FEATURES)
SIGNS = tuple(signs(FEATURES).tolist())


def some_features(rows: int) -> np.ndarray:
    return np.random.default_rng(0).normal(0, 3, (rows, COUNT))


def test_round_trip_through_json() -> None:
    calibration = Calibration(tuple(sign / 3 for sign in SIGNS), 0.25)
    back = Calibration.restore(json.loads(json.dumps(calibration.parameters())))
    assert back == calibration
    assert_array_equal(
        back.probability(some_features(9)), calibration.probability(some_features(9))
    )


def test_calibration_over_other_features_is_refused() -> None:
    parameters = {"features": ["shoe_size"], "weights": [1.0], "bias": 0.0}
    with pytest.raises(ValueError, match="got one over shoe_size"):
        Calibration.restore(parameters)
    with pytest.raises(ValueError, match="got one over nothing"):
        Calibration.restore({})


@pytest.mark.parametrize("features", [FEATURES, RERANKING_FEATURES])
def test_no_confidence_rises_with_the_reprojection_error(features: tuple[str, ...]) -> None:
    """Nor with the distance from the database: such a calibration is refused."""
    for name in ("reprojection_error_px", "log_distance"):
        weights = tuple(0.1 if one == name else 0.0 for one in features)
        with pytest.raises(ValueError, match="signs"):
            Calibration(weights, 0.0, features)


errors = st.floats(0, 1e4)


@given(
    entry=st.tuples(errors, errors),
    fitted=st.tuples(errors, errors),
    reliability=st.floats(0, 1),
    nearer=st.one_of(st.just(np.nan), st.floats(0, 1)),
)
def test_confidence_with_landmarks_never_rises_with_a_reprojection_error(
    entry: tuple[float, float], fitted: tuple[float, float], reliability: float, nearer: float
) -> None:
    rest = (reliability, nearer)
    near, far = (min(entry), min(fitted)), (max(entry), max(fitted))
    features = np.array([[*near, *rest], [far[0], near[1], *rest], [*far, *rest]])
    probabilities = LANDMARK_CONFIDENCE.probability(features)
    assert ((probabilities >= 0) & (probabilities <= 1)).all()
    assert (np.diff(probabilities) <= 0).all()


@given(shares=st.lists(st.floats(0, 1), min_size=2, max_size=9).map(sorted))
def test_alternatives_are_likelier_the_more_of_the_posterior_is_near_them(
    shares: list[float],
) -> None:
    features = np.full((len(shares) + 1, len(LANDMARK_FEATURES)), np.nan)
    features[:, :-1] = 4.0, 1.0, 0.8
    features[1:, -1] = shares
    first, *alternatives = LANDMARK_CONFIDENCE.probability(features)
    assert (np.diff(alternatives) >= 0).all()
    assert max(alternatives) < first


@given(confidences=st.lists(st.floats(0, 1), min_size=1, max_size=9).map(sorted))
def test_weights_follow_confidences(confidences: list[float]) -> None:
    weights = LANDMARK_CONFIDENCE.weights(np.array(confidences))
    assert weights.sum() == pytest.approx(1)
    assert (np.diff(weights) >= 0).all() and (weights >= 0).all()
