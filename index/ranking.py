"""The order of the hypotheses of a silhouette, and their confidence.

An index orders them by their distances alone, or with a network that predicts joints from the
silhouette. :mod:`index.network` is the network; :mod:`index.artefact` reads its file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.confidence import Calibration
from index.modes import Modes
from index.network import Distributions, RankingModel, Reading, joint_positions
from index.skeleton import JOINTS, pixels_per_metre, rows, with_bone_lengths_of

(_PELVIS,) = rows("pelvis")
(_HEAD,) = rows("head")


@dataclass(frozen=True)
class DistanceRanking:
    """Ranks the poses of one silhouette by their distances alone."""

    usual_candidates: ClassVar[int] = 160
    """Number of nearest entries that are usually candidates; more add few useful modes."""

    calibration: Calibration

    def support(self, candidates: Candidates) -> NDArray[np.float64]:
        """Factors ``(K,)`` of the candidates' weights, 1 for the likeliest."""
        return np.ones(len(candidates))

    def fit(self, modes: Modes) -> Modes:
        """Move modes towards other evidence about the joints."""
        return modes

    def distances(self, modes: Modes) -> NDArray[np.float64]:
        """Distances ``(M,)`` of modes."""
        return modes.distances

    def order(self, modes: Modes, n: int) -> tuple[Modes, NDArray[np.float64]]:
        """The ``n`` nearest modes and their distances ``(M,)``, ascending."""
        distances = self.distances(modes)
        nearest = np.argsort(distances, kind="stable")[:n]
        return modes.take(nearest), distances[nearest]

    def features(self, modes: Modes) -> tuple[NDArray[np.float64], ...]:
        """Further features of modes for the calibration, ``(M,)`` each."""
        return ()

    def postures(self, votes: NDArray[np.float64], roll_deg: float) -> NDArray[np.float64]:
        """Shares ``(10,)`` of ``POSTURES``, from those among hypotheses.

        ``roll_deg`` is not 0 if the silhouette was rotated upright.
        """
        return votes


@dataclass(frozen=True)
class NetworkRanking(DistanceRanking):
    """Ranks the poses of one silhouette by the network's predictions of its joints as well."""

    usual_candidates: ClassVar[int] = 200  # The network ranks a few more usefully.

    model: RankingModel
    reading: Reading

    @property
    def joints(self) -> Distributions:
        """Where the joints may be."""
        return self.reading.joints

    @classmethod
    def of(cls, model: RankingModel, silhouette: NDArray[np.uint8]) -> NetworkRanking:
        return cls(model.calibration, model, model.network.read(silhouette))

    def log_likelihood(self, found: Candidates | Modes) -> NDArray[np.float64]:
        """Mean log probability ``(N,)`` of the joints of candidates or modes."""
        return self.joints.log_likelihood(joint_positions(found.points_3d, found.points_normalised))

    def fit(self, modes: Modes) -> Modes:
        """Move the joints of modes towards the places that the network predicts.

        Each joint moves to its posterior mean; its position in the mode is the prior, so that modes
        remain distinct. Bones keep their lengths, and the face moves with the head.
        """
        spread = self.model.spread
        if not all(spread):
            return modes
        positions = joint_positions(modes.points_3d, modes.points_normalised)
        moves = self.joints.posterior_means(positions, spread) - positions
        scale = pixels_per_metre(modes.points_3d, modes.points_normalised)[:, None, None]
        metres = np.concatenate([moves[..., :2] / scale, moves[..., 2:]], axis=-1)
        moved = modes.points_3d.copy()
        moved[:, :JOINTS] += metres
        moved[:, JOINTS:] += metres[:, _HEAD, None]
        moved = with_bone_lengths_of(modes.points_3d, moved)
        placed = modes.points_normalised + (moved - modes.points_3d)[..., :2] * scale
        placed += moves[:, _PELVIS, None, :2]
        return replace(modes, points_3d=moved, points_normalised=placed)

    def support(self, candidates: Candidates) -> NDArray[np.float64]:
        likelihood = self.log_likelihood(candidates)
        return np.exp(self.model.support_weight * (likelihood - likelihood.max()))

    def distances(self, modes: Modes) -> NDArray[np.float64]:
        """Descriptor distances ``(M,)``, increased the more, the less likely the joints are."""
        likelihood = self.log_likelihood(modes)
        lacking = likelihood.max() - likelihood
        return modes.distances * np.exp(self.model.order_weight * lacking)

    def features(self, modes: Modes) -> tuple[NDArray[np.float64], ...]:
        """Those that :data:`index.confidence.RERANKING_FEATURES` has beside the plain ones."""
        positions = joint_positions(modes.points_3d, modes.points_normalised)
        likelihood = self.joints.log_likelihood(positions)
        return likelihood, np.log(self.joints.expected_errors(positions))

    def postures(self, votes: NDArray[np.float64], roll_deg: float) -> NDArray[np.float64]:
        """Probabilities ``(10,)`` of ``POSTURES``, if there is a network that reads them."""
        if self.model.postures is None:
            return votes
        return self.model.postures.shares(self.reading.hidden, roll_deg, votes)
