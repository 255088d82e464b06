"""How well hypotheses fit: distances of outlines, and the features of the confidence."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from index.candidates import find_candidates
from index.confidence import FEATURES
from index.features import match_features, outline_distances
from index.modes import find_modes
from index.store import PoseIndex


@pytest.fixture
def square() -> NDArray[np.uint8]:
    silhouette = np.zeros((128, 48), np.uint8)
    silhouette[40:80, 10:30] = 1
    return silhouette


def test_outline_distance_is_symmetric(square: NDArray[np.uint8]) -> None:
    other = np.roll(square, 5, axis=0)
    other[60:70] = 0
    there = outline_distances(square, other[None])[0]
    assert there == pytest.approx(outline_distances(other, square[None])[0])
    assert there > 0


def test_outline_distance_grows_with_a_shift_and_stays_below_it(square: NDArray[np.uint8]) -> None:
    shifts = np.arange(1, 15)
    distances = outline_distances(square, np.stack([np.roll(square, s, axis=1) for s in shifts]))
    assert (np.diff(distances) > 0).all()
    # Every outline pixel has its own image at the distance of the shift.
    assert (distances <= shifts + 0.1).all()


def test_outline_distance_of_concentric_squares(square: NDArray[np.uint8]) -> None:
    inner = np.zeros_like(square)
    inner[44:76, 14:26] = 1
    # Sides are 4 px apart, only corners farther.
    assert_allclose(outline_distances(square, inner[None]), 4, atol=0.3)


def test_features_of_a_match(toy_index: PoseIndex) -> None:
    candidates = find_candidates(toy_index, toy_index.silhouette(5), 60)
    modes = find_modes(candidates, 5).nearest()
    errors_px = np.arange(len(modes), dtype=float)
    features = match_features(candidates, modes, errors_px)
    column = {name: features[:, FEATURES.index(name)] for name in FEATURES}
    assert features.shape == (len(modes), len(FEATURES)) and np.isfinite(features).all()
    assert (column["log_distance_over_best"] >= 0).all()
    assert (column["log_votes_over_most"] <= 0).all()
    assert (column["reprojection_error_px"] == errors_px).all()
    for kind in ("near", "far"):
        narrow, wide = (column[f"log_agreement_{px}px_{kind}"] for px in (5, 10))
        assert (narrow <= wide).all() and (wide <= np.log(1.001) + 1e-9).all()
