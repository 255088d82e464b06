"""From a silhouette alone to distinct poses in the order of their rank.

Modes of the entries nearest to the silhouette are ordered by their distances. If the index has a
network, the likelihood that it gives to their joints counts as well. The confidence is calibrated.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates, RotatedQuery, find_candidates, silhouette_rotations
from index.confidence import RIGHT_BELOW_PX
from index.facing import front_share
from index.matching import (
    CANDIDATES_PER_HYPOTHESIS,
    DEFAULT_HYPOTHESES,
    MAX_CANDIDATE_GROWTH,
    SPARE_MODES,
    Match,
    PoseHypothesis,
    Query,
    headings,
    votes_of,
    with_later_batches,
)
from index.modes import Modes, candidate_weights, find_modes
from index.ranking import DistanceRanking, NetworkRanking
from index.skeleton import JOINTS, exchange_sides, mean_joint_distance, reversed_in_depth
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
    found, _ = with_later_batches(query.batch, first, n)
    votes = np.array([one.confidence for one in voters])
    return Match(
        found[: max(n, DEFAULT_HYPOTHESES)],
        front_share(headings(voters), votes),
        voters,
        query.ranking.postures(votes_of(voters), roll_deg),
    )


class _SilhouetteQuery(Query):
    """A silhouette without landmarks."""

    @cached_property
    def ranking(self) -> DistanceRanking:
        """The ranking: by the network if there is one."""
        if self.index.reranker is None:
            return DistanceRanking(self.index.calibration)
        return NetworkRanking.of(self.index.reranker, self.silhouette)

    def batch(self, n: int, at_least: float = 0.0) -> list[PoseHypothesis]:
        """Find about ``n`` hypotheses; see :func:`index.matching.with_later_batches`."""
        return self._at_modes(*self._modes(n), at_least)

    def first_batch(self) -> tuple[list[PoseHypothesis], list[PoseHypothesis]]:
        """Find the first hypotheses, and the hypotheses to return.

        An outline cannot exclude the best pose seen from behind, its twin. The twin takes the place
        of the last hypothesis, unless another one is as near to it as a right one would be.
        """
        candidates, modes, distances = self._modes(DEFAULT_HYPOTHESES)
        voters = self._at_modes(candidates, modes, distances)[:DEFAULT_HYPOTHESES]
        best, others = voters[0], modes.take(slice(DEFAULT_HYPOTHESES - 1))
        twin = replace(
            modes.take([0]),
            points_3d=reversed_in_depth(modes.points_3d[:1]),
            points_normalised=exchange_sides(modes.points_normalised[:1]),
        )
        apart = mean_joint_distance(others.points_normalised, twin.points_normalised)
        if apart.min() < RIGHT_BELOW_PX:
            return voters, voters
        shown = others.append(twin)
        distances = self.ranking.distances(shown)
        outline_px = np.array([one.outline_distance_px for one in [*voters[: len(others)], best]])
        features = self.ranking.features(
            _features(candidates, shown, outline_px), shown, distances
        )[-1]
        returned = voters[: len(others)]
        returned.append(
            replace(
                best,
                points_3d=reversed_in_depth(best.points_3d),
                points_normalised=twin.points_normalised[0],
                distance=max(returned[-1].distance, float(distances[-1])),
                confidence=float(self.ranking.calibration.probability(features)),
                twin=True,
                features=features,
            )
        )
        return voters, returned

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
        features = self.ranking.features(_features(candidates, modes, outline_px), modes, distances)
        return self.hypotheses(
            candidates,
            modes,
            distance=np.maximum(distances, at_least),
            confidence=self.ranking.calibration.probability(features),
            outline_distance_px=outline_px,
            features=features,
        )

    def _modes(self, n: int) -> tuple[Candidates, Modes, NDArray[np.float64]]:
        """About ``n`` modes, nearest first, with their distances, and their candidates.

        The number of candidates grows until they have ``n`` modes or the index has no more entries.
        """
        rotations = silhouette_rotations(self.silhouette, self.roll_deg)
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        ranking = self.ranking
        k = max(ranking.usual_candidates, CANDIDATES_PER_HYPOTHESIS * n)
        while True:
            candidates = find_candidates(self.index, queries, k)
            weights = candidate_weights(candidates.distances) * ranking.support(candidates)
            modes = find_modes(candidates, weights, n + SPARE_MODES, fit=ranking.fit)
            exhausted = len(candidates) < k
            if len(modes) >= n or exhausted or k >= MAX_CANDIDATE_GROWTH * ranking.usual_candidates:
                return candidates, *ranking.order(modes, n)
            k *= 2


# Mean joint distances below which a candidate agrees with a mode.
_AGREEMENT_PX = (RIGHT_BELOW_PX, 2 * RIGHT_BELOW_PX)
# Fall-offs of the candidates' weights, as in :func:`index.modes.candidate_weights`.
_AGREEMENT_FALL_OFFS = (0.15, 0.5)


def _features(
    candidates: Candidates, modes: Modes, outline_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """:data:`index.confidence.FEATURES` ``(M, F)`` of modes of the candidates, ordered by rank.

    ``outline_px`` ``(M,)`` are the outline distances between the query and their centres.
    """
    distances, votes = np.log(modes.distances + 1e-6), np.log(modes.votes + 1e-6)
    nearest = np.full(len(modes), np.log(candidates.distances[0] + 1e-6))
    return np.stack(
        [
            distances,
            distances - distances.min(),
            votes,
            votes - votes.max(),
            nearest,
            outline_px,
            np.log(np.arange(1, len(modes) + 1)),
            *np.log(_agreements(candidates, modes) + 1e-3),
        ],
        axis=-1,
    )


def _agreements(candidates: Candidates, modes: Modes) -> NDArray[np.float64]:
    """Weighted shares ``(4, M)`` of the candidates that agree with each mode.

    The share of candidates that agree with a hypothesis predicts better than its own fit whether
    the hypothesis is right.
    """
    mode_joints = modes.points_normalised[:, :JOINTS]
    joints = candidates.points_normalised[:, :JOINTS]
    # Candidates come last, because NumPy is several times slower along short axes.
    joints = joints.transpose(2, 1, 0).copy()
    squares = (mode_joints[:, :, 0, None] - joints[0]) ** 2
    squares += (mode_joints[:, :, 1, None] - joints[1]) ** 2
    errors = np.sqrt(squares).sum(axis=1) / JOINTS
    agree = [(errors < px).astype(np.float64) for px in _AGREEMENT_PX]
    weights = [candidate_weights(candidates.distances, f) for f in _AGREEMENT_FALL_OFFS]
    return np.stack([a @ w / w.sum() for w in weights for a in agree])
