"""The order of hypotheses: how far the silhouette is from them, and what landmarks say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from index.keypoints import Agreement

DISTANCE_WEIGHT, SIDE_WEIGHT = 4.0, 0.3
"""Weights of the log distance of the descriptors (against a hypothesis) and of the log odds of its
sides, beside the landmarks' log likelihood. Chosen on the street people of even-numbered
photographs."""

TILT_SCALE_DEG = 60.0
"""Few people are seen tilted: a tilt of this size makes a hypothesis 1/e as likely."""


def fused_distances(
    distances: NDArray[np.float64], agreement: Agreement, tilt_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances ``(N,)`` of hypotheses from silhouette and landmarks together.

    Parameters
    ----------
    distances : (N,) float64 array
        Of the descriptors.
    agreement : Agreement
        With the landmarks.
    tilt_deg : (N,) float64 array
        In-plane tilt at which the person would be seen.
    """
    likelihood = (
        agreement.log_likelihood
        + SIDE_WEIGHT * agreement.side_log_odds
        - np.abs(tilt_deg) / TILT_SCALE_DEG
    )
    return np.asarray(distances * np.exp(-likelihood / DISTANCE_WEIGHT))
