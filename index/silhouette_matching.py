"""From a silhouette alone to distinct poses in the order of their confidences.

Modes of the entries nearest to the silhouette are chosen by their distances and, if the index has a
network, by the likelihood that it gives to their joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates, RotatedQuery, find_candidates, silhouette_rotations
from index.confidence import RIGHT_BELOW_PX, Calibration
from index.matching import (
    CANDIDATES_PER_HYPOTHESIS,
    DEFAULT_HYPOTHESES,
    MAX_CANDIDATE_GROWTH,
    SPARE_MODES,
    Match,
    PoseHypothesis,
    Query,
    headings,
    likeliest_first,
    ranked,
    votes_of,
    with_later_batches,
)
from index.modes import Modes, candidate_weights, find_modes
from index.network import Distributions, RankingModel, Reading, joint_positions
from index.posture import front_share
from index.skeleton import (
    JOINTS,
    exchange_sides,
    mean_joint_distance,
    pixels_per_metre,
    reversed_in_depth,
    rows,
    with_bone_lengths_of,
)
from index.store import PoseIndex


def match_silhouette(
    index: PoseIndex, silhouette: NDArray[np.uint8], n: int, *, roll_deg: float = 0.0
) -> Match:
    """Find ``n`` distinct poses that fit a silhouette.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    roll_deg : float
        Roll of the camera in the silhouette; not 0 if it was rotated because it is wide.
    """
    query = _SilhouetteQuery(index, silhouette, roll_deg)
    voters, first = query.first_batch()
    found = with_later_batches(query.batch, first, n)
    votes = np.array([one.confidence for one in voters])
    return Match(
        ranked(found[: max(n, DEFAULT_HYPOTHESES)]),
        front_share(headings(voters), votes),
        voters,
        query.ranking.postures(votes_of(voters), roll_deg),
    )


class _SilhouetteQuery(Query):
    """A silhouette without landmarks."""

    @cached_property
    def ranking(self) -> DistanceRanking:
        if self.index.reranker is None:
            return DistanceRanking(self.index.calibration)
        return NetworkRanking.of(self.index.reranker, self.silhouette)

    def batch(self, n: int, at_least: float = 0.0) -> list[PoseHypothesis]:
        return self._at_modes(*self._modes(n), at_least)

    def first_batch(self) -> tuple[list[PoseHypothesis], list[PoseHypothesis]]:
        """Find the first hypotheses, and the hypotheses to return; both likeliest first.

        An outline cannot exclude the best pose seen from behind, its twin. The twin takes the place
        of the last hypothesis, which follows, unless another is as near to it as a right one.
        """
        candidates, modes, distances = self._modes(DEFAULT_HYPOTHESES)
        modes, distances = modes.take(slice(DEFAULT_HYPOTHESES)), distances[:DEFAULT_HYPOTHESES]
        found = self._at_modes(candidates, modes, distances)
        voters = likeliest_first(found)
        best, others = voters[0], voters[: DEFAULT_HYPOTHESES - 1]
        turned = exchange_sides(best.points_2d)
        apart = mean_joint_distance(np.array([one.points_2d for one in others]), turned)
        if apart.min() < RIGHT_BELOW_PX:
            return voters, voters
        row = next(row for row, one in enumerate(found) if one is best)
        mode = modes.take([row])
        twin = replace(
            mode,
            points_3d=reversed_in_depth(mode.points_3d),
            points_normalised=turned[None],
        )
        features = self._features(
            candidates, twin, np.array([best.reprojection_error_px]), np.array([row + 1])
        )[0]
        shown = replace(
            best,
            points_3d=reversed_in_depth(best.points_3d),
            points_2d=turned,
            distance=max(best.distance, float(self.ranking.distances(modes.append(twin))[-1])),
            confidence=min(best.confidence, float(self.ranking.calibration.probability(features))),
            twin=True,
            features=features,
        )
        return voters, [*likeliest_first([*others, shown]), *voters[len(others) :]]

    def _at_modes(
        self,
        candidates: Candidates,
        modes: Modes,
        distances: NDArray[np.float64],
        at_least: float = 0.0,
    ) -> list[PoseHypothesis]:
        """Hypotheses at ranked modes; no distance is smaller than ``at_least``."""
        entries = candidates.take(modes.centres)
        outline_px = self.outline_distances(
            entries.entry_ids, entries.mirrored, entries.rotation_deg
        )
        ranks = np.arange(1, len(modes) + 1)
        features = self._features(candidates, modes, outline_px, ranks)
        return self.hypotheses(
            candidates,
            modes,
            distance=np.maximum(distances, at_least),
            confidence=self.ranking.calibration.probability(features),
            reprojection_error_px=outline_px,
            features=features,
        )

    def _features(
        self,
        candidates: Candidates,
        modes: Modes,
        outline_px: NDArray[np.float64],
        ranks: NDArray[np.integer],
    ) -> NDArray[np.float64]:
        """:data:`index.confidence.FEATURES` ``(M, F)`` of modes, or those with the network.

        ``outline_px`` ``(M,)`` are the outline distances between the query and their centres.
        """
        plain = (
            outline_px,
            np.log(modes.distances + 1e-6),
            np.log(ranks),
            np.log(_agreement(candidates, modes) + 1e-3),
        )
        return np.column_stack([*plain, *self.ranking.features(modes)])

    def _modes(self, n: int) -> tuple[Candidates, Modes, NDArray[np.float64]]:
        """About ``n`` modes, nearest first, with their distances, and their candidates.

        The candidates grow in number until they have ``n`` modes or the index has no more entries.
        """
        rotations = silhouette_rotations(self.silhouette, self.roll_deg)
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        ranking = self.ranking
        k = max(ranking.usual_candidates, CANDIDATES_PER_HYPOTHESIS * n)
        while True:
            candidates = find_candidates(self.index, queries, k)
            weights = candidate_weights(candidates.distances) * ranking.support(candidates)
            modes = find_modes(
                candidates, weights, n + SPARE_MODES, candidates.offsets, ranking.fit
            )
            exhausted = len(candidates) < k
            if len(modes) >= n or exhausted or k >= MAX_CANDIDATE_GROWTH * ranking.usual_candidates:
                return candidates, *ranking.order(modes, n)
            k *= 2


def _agreement(candidates: Candidates, modes: Modes) -> NDArray[np.float64]:
    """Weighted shares ``(M,)`` of the candidates that agree with each mode.

    They predict better than the fit of a hypothesis whether it is right.
    """
    mode_joints = modes.points_normalised[:, :JOINTS]
    joints = candidates.points_normalised[:, :JOINTS]
    # Candidates come last, because NumPy is several times slower along short axes.
    joints = joints.transpose(2, 1, 0).copy()
    squares = (mode_joints[:, :, 0, None] - joints[0]) ** 2
    squares += (mode_joints[:, :, 1, None] - joints[1]) ** 2
    errors = np.sqrt(squares).sum(axis=1) / JOINTS
    # Fall-off of the candidates' weights, as in :func:`index.modes.candidate_weights`.
    weights = candidate_weights(candidates.distances, 0.15)
    return np.asarray((errors < RIGHT_BELOW_PX) @ weights / weights.sum())


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
