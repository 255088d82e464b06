"""The hypotheses of a silhouette, re-ranked by how likely a network finds their joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.joint_network import Distributions
from index.modes import Modes
from index.reranker import Reranker

SHARE_POWER = 4.0
"""Hypotheses share the probability by the inverse of their fused distances to this power."""


@dataclass(frozen=True)
class Ranking:
    """What the network makes of one silhouette.

    Parameters
    ----------
    reranker : Reranker
    seen : Distributions
    """

    reranker: Reranker
    seen: Distributions

    @classmethod
    def of(cls, reranker: Reranker, silhouette: NDArray[np.uint8]) -> Ranking:
        """Have the network look at a silhouette ``(128, 48)``."""
        return cls(reranker, reranker.network.distributions(silhouette))

    def log_likelihood(self, found: Candidates | Modes) -> NDArray[np.float64]:
        """Mean log probability ``(N,)`` of the joints of candidates or modes."""
        return self.seen.log_likelihood(found.points_3d, found.points_normalised)

    def support(self, candidates: Candidates) -> NDArray[np.float64] | None:
        """Factors ``(K,)`` of the weights of candidates, 1 for the likeliest; None if all are 1."""
        if self.reranker.support_weight == 0:
            return None
        likelihood = self.log_likelihood(candidates)
        return np.asarray(np.exp(self.reranker.support_weight * (likelihood - likelihood.max())))

    def distances(self, modes: Modes) -> NDArray[np.float64]:
        """Distances ``(M,)`` of the descriptors, longer the less likely the joints are.

        The likeliest keeps its distance.
        """
        likelihood = self.log_likelihood(modes)
        lacking = likelihood.max() - likelihood
        return np.asarray(modes.distances * np.exp(self.reranker.order_weight * lacking))

    def features(
        self, features: NDArray[np.float64], modes: Modes, distances: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Compute :data:`RERANKING_FEATURES` ``(M, F)``.

        Parameters
        ----------
        features : (M, F) float64 array
            See :func:`index.features.match_features`.
        modes : Modes
        distances : (M,) float64 array
            See :meth:`distances`.
        """
        likelihood = self.log_likelihood(modes)
        odds = -SHARE_POWER * np.log(distances + 1e-6)
        odds -= odds.max()
        return np.column_stack(
            [
                features,
                likelihood,
                likelihood - likelihood.max(),
                likelihood - self.seen.peak(),
                odds - np.log(np.exp(odds).sum()),
            ]
        )
