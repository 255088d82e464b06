"""From a silhouette and landmarks to distinct poses in the order of their rank.

The entries nearest to the silhouette are candidates. They are weighted by their agreement with the
landmarks, and modes are fitted to the landmarks. The best mode is also returned at other depths.
Hypotheses include both facings.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from index.candidates import (
    Candidates,
    RotatedQuery,
    find_candidates,
    landmark_rotations,
    sample_candidates,
    silhouette_rotations,
)
from index.confidence import fused_confidences
from index.facing import (
    azimuth_deg,
    faces_camera,
    front_share,
    heading_shares,
    nearest_of_both_facings,
)
from index.landmarks import (
    DISTANCE_WEIGHT,
    Agreement,
    NormalisedLandmarks,
    fit_to_landmarks,
    fused_distances,
)
from index.matching import (
    CANDIDATES_PER_HYPOTHESIS,
    DEFAULT_HYPOTHESES,
    MAX_CANDIDATE_GROWTH,
    SPARE_MODES,
    Match,
    PoseHypothesis,
    Query,
    headings,
    unlike,
    votes_of,
    with_later_batches,
)
from index.modes import Modes, depth_modes, find_modes, likely_weights
from index.skeleton import (
    LIMB_HIPS,
    LIMB_SHOULDERS,
    mean_joint_distance,
    moved_in_depth,
)
from index.store import PoseIndex


def match_landmarks(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    n: int,
    landmarks: NormalisedLandmarks,
    *,
    roll_deg: float = 0.0,
    whole: bool = True,
    outlines: int | None = None,
) -> Match:
    """Find ``n`` distinct poses that fit a silhouette and landmarks.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    roll_deg : float
        Roll of the camera in the silhouette and the landmarks; not 0 if they were rotated because
        the silhouette is wide.
    whole : bool
        Whether the silhouette shows the whole body. If not, landmarks alone choose and place the
        candidates, from a sample of the index.
    outlines : int, optional
        How many hypotheses, best first, have an outline distance; by default all.
    """
    query = _LandmarkQuery(index, silhouette, roll_deg, landmarks, whole)
    voters, alternatives = query.first_batch()
    voters_deg, votes = headings(voters), np.array([one.confidence for one in voters])
    front_probability = front_share(voters_deg, votes)
    first, weighted = _weighted(voters, alternatives, front_probability)
    found, pools = with_later_batches(query.batch, first, n)
    best = [1] + [weighted] * (min(DEFAULT_HYPOTHESES, weighted) - 1)
    pools[: len(best)] = best
    azimuths = headings(found)
    # A skeleton is at most as likely to be right as its heading.
    shares = heading_shares(azimuths, voters_deg, votes)
    confidences = np.minimum([one.confidence for one in found], shares).tolist()
    distances = np.array([one.distance for one in found])
    count = max(n, DEFAULT_HYPOTHESES)
    chosen = nearest_of_both_facings(azimuths, distances, front_probability, pools[:count])
    outlined = [found[row] for row in chosen[:outlines]]
    outline_px = np.full(len(chosen), np.nan)
    outline_px[: len(outlined)] = query.outline_distances(
        np.array([one.entry_id for one in outlined], np.int64),
        np.array([one.mirrored for one in outlined], bool),
        np.array([one.rotation_deg for one in outlined]) + roll_deg,
    )
    ascending = np.maximum.accumulate(distances[chosen])
    hypotheses = [
        replace(
            found[row],
            distance=distance,
            confidence=confidences[row],
            weight=found[row].weight or 0.0,
            outline_distance_px=pixels,
        )
        for row, distance, pixels in zip(
            chosen, ascending.tolist(), outline_px.tolist(), strict=True
        )
    ]
    return Match(hypotheses, front_probability, voters, votes_of(voters))


def _weighted(
    modes: Sequence[PoseHypothesis],
    alternatives: Sequence[PoseHypothesis],
    front_probability: float,
) -> tuple[list[PoseHypothesis], int]:
    """Weigh the best mode, its alternatives, and the modes that face the opposite way.

    Returns
    -------
    hypotheses : list of PoseHypothesis
        In this order; modes that differ from all of these follow with weight 0.
    weighted : int
        Number of hypotheses before those with weight 0.
    """
    front = faces_camera(headings(modes))
    same = front == front[0]
    facing, away = (list(compress(modes, rows)) for rows in (same, ~same))
    share = front_probability if front[0] else 1 - front_probability
    votes = sum(one.confidence for one in away) + 1e-9
    shares = [one.weight or 0.0 for one in alternatives]
    weights = [share * (1 - sum(shares)), *(share * one for one in shares)]
    weights += [(1 - share) * one.confidence / votes for one in away]
    weighted = [
        replace(one, weight=weight)
        for one, weight in zip([facing[0], *alternatives, *away], weights, strict=True)
    ]
    return weighted + unlike(facing[1:], weighted), len(weighted)


# Entries nearest to each rotation of the silhouette, and how many of them, those that agree best
# with the landmarks, make the modes.
_CANDIDATES, _KEPT = 500, 100
# The same where the silhouette is not whole: entries of a sample, and how many are kept.
_SAMPLE, _KEPT_OF_SAMPLE = 1000, 50
# Candidates that decide which action is the usual one, for each that is kept.
_VOTES_PER_KEPT = 3


@dataclass(frozen=True)
class _LandmarkQuery(Query):
    """A silhouette with landmarks; see :func:`match_landmarks`."""

    landmarks: NormalisedLandmarks
    whole: bool

    def batch(self, n: int, at_least: float = 0.0) -> list[PoseHypothesis]:
        """Find about ``n`` hypotheses; see :func:`index.matching.with_later_batches`."""
        candidates, _, modes, typical = self._modes(n)
        modes, distances = self._fitted(candidates, modes, typical)
        distances = np.maximum(distances, at_least)
        confidence = _confidences(candidates, modes, distances)
        return self.hypotheses(candidates, modes, distance=distances, confidence=confidence)

    def first_batch(self) -> tuple[list[PoseHypothesis], list[PoseHypothesis]]:
        """Find the first hypotheses, and the best one at other depths; both nearest first."""
        candidates, agreement, modes, typical = self._modes(DEFAULT_HYPOTHESES)
        modes, distances = self._fitted(candidates, modes, typical)
        # Of the hypotheses, one is the mode as found, and one faces the opposite way.
        depths = depth_modes(candidates, self.landmarks, agreement, DEFAULT_HYPOTHESES - 2)
        first = modes.take(np.zeros(len(depths.shares), np.int64))
        others = replace(
            first, votes=depths.shares, points_3d=moved_in_depth(modes.points_3d[0], depths.offsets)
        )
        confidences = _confidences(candidates, modes, distances)
        other_distances = distances[0] * np.exp(depths.misfits / DISTANCE_WEIGHT)
        both = self.hypotheses(
            candidates,
            modes.append(others),
            distance=np.concatenate([distances, other_distances]),
            confidence=np.concatenate([confidences, np.full(len(others), confidences[0])]),
            weight=np.concatenate([np.zeros(len(modes)), others.votes]),
        )
        found, alternatives = both[: len(modes)], both[len(modes) :]
        return found, sorted(alternatives, key=lambda one: one.distance)

    def _fitted(
        self, candidates: Candidates, modes: Modes, typical: NDArray[np.bool_]
    ) -> tuple[Modes, NDArray[np.float64]]:
        """Modes fitted to the landmarks, nearest first, and their distances.

        They are compared before the fit: a pose that must change far to fit is less likely. Their
        centres become the entries that look most like them: of the typical candidates ``(K,)`` that
        face as they do, the one with the nearest silhouette.
        """
        agreement = self.landmarks.compare(modes.points_normalised, modes.points_3d)
        _, tilt_deg = self.rotations(candidates.take(modes.centres))
        distances = fused_distances(modes.distances, agreement, tilt_deg)
        nearest = np.argsort(distances, kind="stable")
        modes = modes.take(nearest)
        points_3d, placed = fit_to_landmarks(
            self.landmarks, modes.points_3d, modes.points_normalised
        )
        facing, front = (
            faces_camera(azimuth_deg(one)) for one in (candidates.points_3d, points_3d)
        )
        like = ((facing == front[:, None]) + 2 * typical).argmax(
            axis=1
        )  # The first is the nearest.
        modes = replace(modes, centres=like, points_3d=points_3d, points_normalised=placed)
        return modes, distances[nearest]

    def _modes(self, n: int) -> tuple[Candidates, Agreement, Modes, NDArray[np.bool_]]:
        """Modes of the candidates that agree best with the landmarks, and these candidates.

        Also whether the action of each is that of most candidates.
        """
        growth = max(1, math.ceil(CANDIDATES_PER_HYPOTHESIS * n / _CANDIDATES))
        usual = silhouette_rotations(self.silhouette, self.roll_deg)
        rotations = landmark_rotations(usual, _trunk_tilt_deg(self.landmarks.limbs_3d))
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        known = 0
        while True:
            if self.whole:
                found = find_candidates(self.index, queries, growth * _CANDIDATES)
                kept = self._likeliest(found, found.distances, growth * _KEPT)
            else:
                found = sample_candidates(self.index, queries, growth * _SAMPLE)
                found = _placed_by_landmarks(found, self.landmarks)
                kept = self._likeliest(found, np.ones(len(found)), growth * _KEPT_OF_SAMPLE)
            candidates, agreement, weights, typical = kept
            modes = find_modes(
                candidates, weights, n + SPARE_MODES, residuals=[agreement.residuals]
            )
            exhausted, known = len(found) <= known, len(found)
            if len(modes) >= n or exhausted or growth >= MAX_CANDIDATE_GROWTH:
                return candidates, agreement, modes, typical
            growth *= 2

    def _likeliest(
        self, candidates: Candidates, distances: NDArray[np.float64], count: int
    ) -> tuple[Candidates, Agreement, NDArray[np.float64], NDArray[np.bool_]]:
        """Candidates with the largest weights, ordered by distance, their agreement and weights.

        Also whether the action of each is that of most candidates.
        """
        agreement = self.landmarks.compare(candidates.points_normalised, candidates.points_3d)
        weights = likely_weights(distances, agreement)
        likeliest = np.argsort(-weights, kind="stable")
        skeletons = self.index.entries["skeleton"][candidates.entry_ids]
        actions = self.index.skeleton_labels["action"][skeletons]
        typical = actions == np.bincount(actions[likeliest[: _VOTES_PER_KEPT * count]]).argmax()
        kept = np.sort(likeliest[:count])  # Back in ascending distance.
        return candidates.take(kept), agreement.take(kept), weights[kept], typical[kept]


def _confidences(
    candidates: Candidates, modes: Modes, distances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Confidences ``(M,)`` of modes fitted to landmarks, at their distances."""
    adjusted_m = mean_joint_distance(modes.points_3d, candidates.points_3d[modes.centres])
    return fused_confidences(distances, adjusted_m)


def _trunk_tilt_deg(limbs_3d: NDArray[np.float64]) -> float:
    """Clockwise tilt in the picture of the trunk of limbs ``(12, 3)``: 0 if upright."""
    hips, shoulders = (limbs_3d[pair].mean(axis=0) for pair in (LIMB_HIPS, LIMB_SHOULDERS))
    right, down, _ = (shoulders - hips).tolist()
    return float(np.rad2deg(np.arctan2(right, -down)))


# Smallest scale at which candidates are placed by landmarks.
_MIN_PX_PER_METRE = 5.0


def _placed_by_landmarks(candidates: Candidates, landmarks: NormalisedLandmarks) -> Candidates:
    """Candidates placed in the picture by the landmarks, by weighted least squares."""
    rows = list(landmarks.rows)
    weights = (landmarks.scores / landmarks.scores.sum())[None, :, None]
    plane = candidates.points_3d[..., :2]
    middle = (weights * plane[:, rows]).sum(axis=1, keepdims=True)
    target = (weights[0] * landmarks.positions).sum(axis=0)
    from_middle = plane[:, rows] - middle
    to_landmarks = landmarks.positions - target
    scale = (weights * from_middle * to_landmarks).sum(axis=(1, 2)) / np.maximum(
        (weights * from_middle**2).sum(axis=(1, 2)), 1e-9
    )
    placed = (plane - middle) * np.maximum(scale, _MIN_PX_PER_METRE)[:, None, None] + target
    return replace(candidates, points_normalised=placed)
