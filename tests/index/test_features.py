"""The features of the confidence."""

from __future__ import annotations

import numpy as np

from index.candidates import find_candidates
from index.confidence import FEATURES
from index.matching import match_features
from index.modes import find_modes
from index.store import PoseIndex


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
