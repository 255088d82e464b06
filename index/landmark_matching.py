"""From a silhouette and landmarks to distinct poses in the order of their rank.

The entries nearest to the landmarks are candidates as well as those nearest to the silhouette.
Candidates are weighted by their agreement with the landmarks, and modes are fitted to the
landmarks. The best mode is also returned at other depths. Hypotheses include both facings.
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
    silhouette_rotations,
)
from index.confidence import fused_confidences
from index.facing import faces_camera, front_share, heading_shares, nearest_of_both_facings
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
from index.search import NearestEntries
from index.skeleton import (
    LIMB_HIPS,
    LIMB_SHOULDERS,
    mean_joint_distance,
    moved_in_depth,
    rotate_clockwise,
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
        candidates.
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


# Number of entries nearest to each rotation of the silhouette, number of entries nearest to the
# landmarks, and number of the best of both, from which the modes are made.
_SILHOUETTE_CANDIDATES, _LANDMARK_CANDIDATES, _KEPT_CANDIDATES = 150, 50, 200


@dataclass(frozen=True)
class _LandmarkQuery(Query):
    """A silhouette with landmarks; see :func:`match_landmarks`."""

    landmarks: NormalisedLandmarks
    whole: bool

    def batch(self, n: int, at_least: float = 0.0) -> list[PoseHypothesis]:
        """Find about ``n`` hypotheses; see :func:`index.matching.with_later_batches`."""
        candidates, _, modes = self._modes(n)
        modes, distances = self._fitted(candidates, modes)
        distances = np.maximum(distances, at_least)
        confidence = _confidences(candidates, modes, distances)
        return self.hypotheses(candidates, modes, distance=distances, confidence=confidence)

    def first_batch(self) -> tuple[list[PoseHypothesis], list[PoseHypothesis]]:
        """Find the first hypotheses, and the best one at other depths; both nearest first."""
        candidates, agreement, modes = self._modes(DEFAULT_HYPOTHESES)
        modes, distances = self._fitted(candidates, modes)
        # Of the hypotheses, one is the mode as found, and one faces the opposite way.
        depths = depth_modes(candidates, self.landmarks, agreement, DEFAULT_HYPOTHESES - 2)
        others = Modes(
            depths.rows,
            depths.shares,
            candidates.distances[depths.rows],
            moved_in_depth(modes.points_3d[0], depths.offsets),
            modes.points_normalised[:1].repeat(len(depths.rows), axis=0),
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

    def _fitted(self, candidates: Candidates, modes: Modes) -> tuple[Modes, NDArray[np.float64]]:
        """Modes fitted to the landmarks, nearest first, and their distances.

        They are compared before the fit: a pose that must change far to fit is less likely.
        """
        agreement = self.landmarks.compare(modes.points_normalised, modes.points_3d)
        _, tilt_deg = self.rotations(candidates.take(modes.centres))
        distances = fused_distances(modes.distances, agreement, tilt_deg)
        nearest = np.argsort(distances, kind="stable")
        modes = modes.take(nearest)
        points_3d, placed = fit_to_landmarks(
            self.landmarks, modes.points_3d, modes.points_normalised
        )
        return replace(modes, points_3d=points_3d, points_normalised=placed), distances[nearest]

    def _modes(self, n: int) -> tuple[Candidates, Agreement, Modes]:
        """Modes of candidates near the silhouette and the landmarks, weighted by agreement.

        Unless the silhouette is whole, only entries near the landmarks are candidates.
        """
        growth = max(1, math.ceil(CANDIDATES_PER_HYPOTHESIS * n / _SILHOUETTE_CANDIDATES))
        nearest = self._near_landmarks(growth)
        usual = silhouette_rotations(self.silhouette, self.roll_deg)
        rotations = landmark_rotations(usual, nearest.roll_deg)
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        known = 0
        while True:
            k = growth * _SILHOUETTE_CANDIDATES if self.whole else 0
            candidates = find_candidates(self.index, queries, k, nearest)
            exhausted, known = len(candidates) <= known, len(candidates)
            candidates, agreement = self._likeliest(candidates, growth * _KEPT_CANDIDATES)
            weights = likely_weights(candidates.distances, agreement)
            modes = find_modes(
                candidates, weights, n + SPARE_MODES, residuals=[agreement.residuals]
            )
            if len(modes) >= n or exhausted or growth >= MAX_CANDIDATE_GROWTH:
                return candidates, agreement, modes
            growth *= 2
            nearest = self._near_landmarks(growth)

    def _near_landmarks(self, growth: int) -> NearestEntries:
        """Entries near the landmarks in three dimensions, with their rotations in the query."""
        limbs_3d = rotate_clockwise(self.landmarks.limbs_3d, -self.roll_deg)
        nearest = self.index.landmark_search.nearest(
            limbs_3d, _likely_rolls(limbs_3d), growth * _LANDMARK_CANDIDATES
        )
        entry_roll_deg = self.index.roll_deg(nearest.entry_ids, nearest.mirrored)
        return replace(nearest, roll_deg=nearest.roll_deg - entry_roll_deg + self.roll_deg)

    def _likeliest(self, candidates: Candidates, count: int) -> tuple[Candidates, Agreement]:
        """Candidates with the largest weights, ordered by distance, with their agreement."""
        if not self.whole:
            candidates = _placed_by_landmarks(candidates, self.landmarks)
        agreement = self.landmarks.compare(candidates.points_normalised, candidates.points_3d)
        distances = candidates.distances if self.whole else np.ones(len(candidates))
        kept = np.argsort(-likely_weights(distances, agreement), kind="stable")[:count]
        kept.sort()  # Back in ascending distance.
        return candidates.take(kept), agreement.take(kept)


def _confidences(
    candidates: Candidates, modes: Modes, distances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Confidences ``(M,)`` of modes fitted to landmarks, at their distances."""
    adjusted_m = mean_joint_distance(modes.points_3d, candidates.points_3d[modes.centres])
    return fused_confidences(distances, adjusted_m)


# Tilt of the trunk below which landmarks are searched only as they are.
_MAX_UPRIGHT_TRUNK_DEG = 12.0


def _likely_rolls(limbs_3d: NDArray[np.float64]) -> tuple[float, ...]:
    """Rolls of the camera that limbs ``(12, 3)`` suggest: 0, and the tilt of the trunk."""
    hips, shoulders = (limbs_3d[pair].mean(axis=0) for pair in (LIMB_HIPS, LIMB_SHOULDERS))
    right, down, _ = (shoulders - hips).tolist()
    roll_deg = float(np.rad2deg(np.arctan2(right, -down)))
    return (0.0,) if abs(roll_deg) < _MAX_UPRIGHT_TRUNK_DEG else (0.0, roll_deg)


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
