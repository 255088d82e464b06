"""The order of hypotheses: by landmarks, or by a network that reads joints off the silhouette."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.keypoints import Agreement
from index.modes import Modes
from index.network import Distributions, joint_positions
from index.reranker import RankingModel
from index.skeleton import JOINT_NAMES, JOINTS, pixels_per_metre, with_bone_lengths_of

SHARE_POWER = 4.0
"""Hypotheses share the probability by the inverse of their fused distances to this power."""

DISTANCE_WEIGHT, SIDE_WEIGHT = 4.0, 0.3
"""Weights of the log distance of the descriptors (against a hypothesis) and of the log odds of its
sides, beside the landmarks' log likelihood. Chosen on the street people of even-numbered
photographs."""

TILT_SCALE_DEG = 60.0
"""Few people are seen tilted: a tilt of this size makes a hypothesis 1/e as likely."""

_PELVIS, _HEAD = JOINT_NAMES.index("pelvis"), JOINT_NAMES.index("head")


@dataclass(frozen=True)
class Ranking:
    """What the network makes of one silhouette.

    Parameters
    ----------
    reranker : RankingModel
    seen : Distributions
    """

    reranker: RankingModel
    seen: Distributions

    @classmethod
    def of(cls, reranker: RankingModel, silhouette: NDArray[np.uint8]) -> Ranking:
        """Have the network look at a silhouette ``(128, 48)``."""
        return cls(reranker, reranker.network.distributions(silhouette))

    def log_likelihood(self, found: Candidates | Modes) -> NDArray[np.float64]:
        """Mean log probability ``(N,)`` of the joints of candidates or modes."""
        return self.seen.log_likelihood(joint_positions(found.points_3d, found.points_normalised))

    def fitted(self, modes: Modes) -> Modes:
        """Modes whose joints have moved to where the network sees them nearby.

        Each to its posterior mean, where the mode's own place is the prior, so that a mode stays
        another one than the next. Bones keep their lengths, and the face moves with the head.
        """
        spread = self.reranker.spread
        if not all(spread):
            return modes
        positions = joint_positions(modes.points_3d, modes.points_normalised)
        moves = self.seen.posterior_means(positions, spread) - positions
        scale = pixels_per_metre(modes.points_3d, modes.points_normalised)[:, None, None]
        metres = np.concatenate([moves[..., :2] / scale, moves[..., 2:]], axis=-1)
        moved = modes.points_3d.copy()
        moved[:, :JOINTS] += metres
        moved[:, JOINTS:] += metres[:, _HEAD, None]
        moved = with_bone_lengths_of(modes.points_3d, moved)
        placed = modes.points_normalised + (moved - modes.points_3d)[..., :2] * scale
        placed += moves[:, _PELVIS, None, :2]
        return replace(modes, points_3d=moved, points_normalised=placed)

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
        positions = joint_positions(modes.points_3d, modes.points_normalised)
        likelihood = self.seen.log_likelihood(positions)
        error = np.log(self.seen.expected_errors(positions))
        odds = -SHARE_POWER * np.log(distances + 1e-6)
        odds -= odds.max()
        return np.column_stack(
            [
                features,
                likelihood,
                likelihood - likelihood.max(),
                likelihood - self.seen.peak(),
                odds - np.log(np.exp(odds).sum()),
                error,
                error**2,
            ]
        )


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
