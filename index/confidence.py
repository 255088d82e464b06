"""The probability that a hypothesis is right.

A hypothesis is right if the mean distance of its limb joints from the person's own, in the picture,
is below :data:`RIGHT_BELOW_PX`; an alternative in depth if, moreover, its depths are nearer to the
truth than those of the first hypothesis, whose joints in the picture it has.

With landmarks, the probability follows from the reprojection error and from how far the landmarks
are likely to be off, by constants fitted to rendered people
(:mod:`scripts.training.fit_confidence`). For a silhouette alone, it follows from features of the
match, by a calibration that is stored with the index (:mod:`scripts.index.calibrate`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

RIGHT_BELOW_PX = 5.0
"""Mean distance of the limb joints, in pixels of the normalised frame, below which a hypothesis is
right."""


LANDMARK_FEATURES = ("reprojection_error_px", "fitted_error_px", "reliability", "nearer")
"""Features of a hypothesis with landmarks, computed by :mod:`index.landmark_matching`:

- its reprojection error, and what is left of it after the fit; an alternative in depth has those of
  the first hypothesis;
- probability that the landmarks are right;
- share of the posterior of the depths that is nearer to an alternative in depth than to the first
  hypothesis; not a number for others.
"""


@dataclass(frozen=True)
class ConfidenceModel:
    """The confidence of hypotheses with landmarks, from :data:`LANDMARK_FEATURES`.

    The mean distance of the limb joints from the true ones has the median ``expected_px``: the
    root of the sum of squares of what the landmarks err and of shares of both errors. Its logarithm
    has a logistic distribution.
    """

    # Median error of landmarks that are as likely to be right as to be wrong.
    landmarks_px: float
    # Power of the odds that landmarks are right by which they err less.
    reliability_power: float
    # Shares of the reprojection error and of what is left of it after the fit.
    reprojection_share: float
    fitted_share: float
    # Power of the expected error by which the odds that a hypothesis is right fall.
    sharpness: float
    # Log odds that an alternative in depth is nearer to the truth than the first hypothesis: an
    # offset, and the weight of those by the posterior of the depths.
    depth_offset: float
    depth_weight: float
    # Power of the confidences by which hypotheses share the probability of being the nearest.
    weight_power: float

    def probability(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probabilities ``(N,)`` for features ``(N, 4)``; they fall with both errors."""
        error_px, fitted_px, reliability, nearer = features.T
        landmarks_px = self.landmarks_px * _odds(reliability) ** -self.reliability_power
        of_skeleton = np.hypot(self.reprojection_share * error_px, self.fitted_share * fitted_px)
        expected_px = np.hypot(landmarks_px, of_skeleton)
        right = 1 / (1 + (expected_px / RIGHT_BELOW_PX) ** self.sharpness)
        log_odds = self.depth_offset + self.depth_weight * np.log(_odds(nearer))
        return np.asarray(right * np.where(np.isnan(nearer), 1.0, _sigmoid(log_odds)))

    def weights(self, confidences: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probabilities ``(N,)`` that each hypothesis is the nearest of all, in space."""
        powers = np.maximum(confidences, 1e-9) ** self.weight_power
        return powers / powers.sum()


# Fitted by `python -m scripts fit-confidence` to the hypotheses of 450 rendered people.
LANDMARK_CONFIDENCE = ConfidenceModel(
    landmarks_px=3.689,
    reliability_power=0.325,
    reprojection_share=0.315,
    fitted_share=1.173,
    sharpness=3.093,
    depth_offset=-0.675,
    depth_weight=0.404,
    weight_power=0.124,
)


FEATURES = ("reprojection_error_px", "log_distance", "log_rank", "log_agreement")
"""Features of a hypothesis of a silhouette alone, computed by :mod:`index.silhouette_matching`:

- its reprojection error, between the outlines;
- logarithms of its descriptor distance and of its rank by distance;
- logarithm of the weighted share of candidates that agree with it: those with a mean joint distance
  from it below :data:`RIGHT_BELOW_PX`, with weights that fall off with their descriptor distance.
"""

RERANKING_FEATURES = (*FEATURES, "log_likelihood", "log_expected_error_px")
"""Features of a hypothesis if there is a network: those above, the log-likelihood of its joints,
and the logarithm of their error as the network expects it."""

_RISING = ("log_agreement", "log_likelihood")
"""Features with which a confidence rises; with all others, it falls."""


def signs(features: tuple[str, ...]) -> NDArray[np.float64]:
    """1 for each feature with which a confidence rises, -1 for the others."""
    return np.where(np.isin(features, _RISING), 1.0, -1.0)


@dataclass(frozen=True)
class Calibration:
    """Logistic model of the probability that a hypothesis is right.

    No weight is against :func:`signs`: the probability falls as the reprojection error grows.
    """

    weights: tuple[float, ...]  # weight of each feature
    bias: float
    # Names of the features, as a guard against a calibration for other features.
    features: tuple[str, ...] = FEATURES

    def __post_init__(self) -> None:
        count = len(self.features)
        if len(self.weights) != count or not np.isfinite((*self.weights, self.bias)).all():
            raise ValueError(f"expected {count} finite weights and a finite bias, got {self}")
        if (np.array(self.weights) * signs(self.features) < 0).any():
            raise ValueError(f"expected weights with the signs of their features, got {self}")

    @classmethod
    def none(cls, features: tuple[str, ...] = FEATURES) -> Calibration:
        """A calibration that gives every hypothesis a probability of 0.5."""
        return cls((0.0,) * len(features), 0.0, features)

    def probability(self, features: NDArray[np.floating]) -> NDArray[np.float64]:
        """Probabilities ``(B,)`` of hypotheses with features ``(B, F)``."""
        logit = np.asarray(features, np.float64) @ np.array(self.weights) + self.bias
        return _sigmoid(logit)

    def parameters(self) -> dict[str, Any]:
        """JSON values for a manifest."""
        return {"features": list(self.features), "weights": list(self.weights), "bias": self.bias}

    @classmethod
    def restore(
        cls, parameters: Mapping[str, Any], features: tuple[str, ...] = FEATURES
    ) -> Calibration:
        """Inverse of :meth:`parameters`; ``ValueError`` if the features differ."""
        if list(parameters.get("features", ())) != list(features):
            raise ValueError(
                f"expected a calibration over {', '.join(features)}, "
                f"got one over {', '.join(parameters.get('features', ())) or 'nothing'}"
            )
        return cls(tuple(parameters["weights"]), float(parameters["bias"]), features)


def _odds(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    inside = np.clip(probabilities, 1e-3, 1 - 1e-3)
    return inside / (1 - inside)


def _sigmoid(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1.0 / (1.0 + np.exp(-np.clip(log_odds, -30, 30)))
