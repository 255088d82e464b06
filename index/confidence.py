"""From what a match shows to the probability that it is right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FEATURES = (
    "log_distance",
    "log_distance_over_best",
    "log_votes",
    "log_votes_over_most",
    "log_nearest",
    "reprojection_error_px",
    "log_rank",
    "log_agreement_5px_near",
    "log_agreement_10px_near",
    "log_agreement_5px_far",
    "log_agreement_10px_far",
)
"""What a hypothesis shows of itself:

the logarithm of its descriptor distance, and how much more it is than the best's; the
logarithm of the share of candidates that agree on it, and how much less that is than the most
agreed one's; the logarithm of the distance to the nearest entry of all; how far its outline lies
from the query's; the logarithm of its rank; and the logarithms of the shares of the candidates
whose joints lie within 5 or 10 px of its own, where only the nearest candidates count much, or
those farther off as well.
"""

RIGHT_BELOW_PX = 5.0
"""A hypothesis is right when its mean joint reprojection error is below this, in 128x48."""


@dataclass(frozen=True)
class Calibration:
    """Logistic model of the probability that a hypothesis is right.

    Parameters
    ----------
    weights : tuple of float
        One for each of :data:`FEATURES`.
    bias : float
    """

    weights: tuple[float, ...]
    bias: float

    def __post_init__(self) -> None:
        if len(self.weights) != len(FEATURES) or not np.isfinite((*self.weights, self.bias)).all():
            raise ValueError(
                f"expected {len(FEATURES)} finite weights and a finite bias, got {self}"
            )

    @classmethod
    def none(cls) -> Calibration:
        """A calibration that knows nothing: one half for everything."""
        return cls((0.0,) * len(FEATURES), 0.0)

    def probability(self, features: NDArray[np.floating]) -> NDArray[np.float64]:
        """Features ``(B, F)`` to probabilities ``(B,)``."""
        logit = np.asarray(features, np.float64) @ np.array(self.weights) + self.bias
        probability: NDArray[np.float64] = 1.0 / (1.0 + np.exp(-np.clip(logit, -30, 30)))
        return probability

    def parameters(self) -> dict[str, Any]:
        """JSON values for a manifest."""
        return {"features": list(FEATURES), "weights": list(self.weights), "bias": self.bias}

    @classmethod
    def restore(cls, parameters: Mapping[str, Any]) -> Calibration:
        """Inverse of :meth:`parameters`; ``ValueError`` for another set of features."""
        if list(parameters.get("features", ())) != list(FEATURES):
            raise ValueError(
                f"expected a calibration over {', '.join(FEATURES)}, "
                f"got one over {', '.join(parameters.get('features', ())) or 'nothing'}"
            )
        return cls(tuple(parameters["weights"]), float(parameters["bias"]))
