"""From a silhouette and landmarks to distinct poses in the order of their rank.

The entries nearest to the silhouette are weighted by their agreement with the landmarks, and their
modes are fitted to the landmarks. The best mode is also returned at other depths. Hypotheses
include both facings.
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
from index.confidence import LANDMARK_CONFIDENCE, LANDMARK_FEATURES
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
    likeliest_first,
    ranked,
    unlike,
    votes_of,
    with_later_batches,
)
from index.modes import Modes, depth_modes, find_modes, likely_weights
from index.posture import azimuth_deg, faces_camera, front_share, likeliest_of_both_facings
from index.skeleton import (
    LIMB_HIPS,
    LIMB_SHOULDERS,
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
    reliability: float = 0.5,
) -> Match:
    """Find ``n`` distinct poses that fit a silhouette and landmarks.

    If the silhouette does not show the whole body, landmarks alone choose and place the candidates,
    from a sample of the index.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    roll_deg : float
        Roll of the camera in the silhouette and the landmarks; not 0 if they were rotated because
        the silhouette is wide.
    reliability : float
        Probability that the landmarks are right, for the confidences.
    """
    query = _LandmarkQuery(index, silhouette, roll_deg, landmarks, reliability)
    voters, alternatives = query.first_batch()
    voters_deg, votes = headings(voters), np.array([one.confidence for one in voters])
    front_probability = front_share(voters_deg, votes)
    first = _first_batch(voters, alternatives, front_probability)
    found = with_later_batches(query.batch, first, n)
    confidences = np.array([one.confidence for one in first[:DEFAULT_HYPOTHESES]])
    weights = LANDMARK_CONFIDENCE.weights(confidences).tolist()
    hypotheses = ranked(found[: max(n, DEFAULT_HYPOTHESES)], weights)
    return Match(hypotheses, front_probability, voters, votes_of(voters))


def moved_along(found: Match, landmarks: NormalisedLandmarks, roll_deg: float) -> Match:
    """The hypotheses found in an earlier frame, fitted to the landmarks of a later one.

    Both are in the normalised frame of the earlier one, with ``roll_deg`` as for
    :func:`match_landmarks`. The first at other depths keeps its distances in depth.
    """
    first = found.hypotheses[0]
    own = [one for one in found.hypotheses if not one.in_depth]
    points_3d, placed = fit_to_landmarks(
        landmarks,
        rotate_clockwise(np.array([one.points_3d for one in own]), roll_deg),
        np.array([one.points_2d for one in own]),
    )
    points_3d = rotate_clockwise(points_3d, -roll_deg)
    fitted = iter(zip(points_3d, placed, strict=True))
    moved = []
    for one in found.hypotheses:
        if one.in_depth:
            points = points_3d[0] + one.points_3d - first.points_3d, placed[0]
        else:
            points = next(fitted)
        moved.append(replace(one, points_3d=points[0], points_2d=points[1]))
    return replace(found, hypotheses=moved)


def _first_batch(
    voters: Sequence[PoseHypothesis],
    alternatives: Sequence[PoseHypothesis],
    front_probability: float,
) -> list[PoseHypothesis]:
    """The first seven hypotheses, then the others of the first batch.

    The seven are the best mode, its alternatives in depth and modes that face the opposite way; if
    these are too few, modes of the same facing as well.
    """
    front = faces_camera(headings(voters))
    away = [*compress(voters, front != front[0])]
    leading = [voters[0], *alternatives, *away]
    others = unlike([*compress(voters[1:], front[1:] == front[0])], leading)
    leading += others[: max(0, DEFAULT_HYPOTHESES - len(leading))]
    confidences = np.array([one.confidence for one in leading])
    rows = likeliest_of_both_facings(
        headings(leading), confidences, front_probability, DEFAULT_HYPOTHESES
    )
    chosen = [leading[row] for row in rows]
    left = [one for row, one in enumerate(leading) if row not in rows]
    left += others[max(0, DEFAULT_HYPOTHESES - len(leading)) :]
    return chosen + likeliest_first(left)


_CANDIDATES = 500  # Entries nearest to each rotation of the silhouette.


@dataclass(frozen=True)
class _LandmarkQuery(Query):
    """A silhouette with landmarks; see :func:`match_landmarks`."""

    landmarks: NormalisedLandmarks
    reliability: float

    def batch(self, n: int, at_least: float = 0.0) -> list[PoseHypothesis]:
        candidates, _, modes, typical = self._modes(n)
        modes, columns = self._fitted(candidates, modes, typical)
        columns["distance"] = np.maximum(columns["distance"], at_least)
        return self.hypotheses(candidates, modes, **columns)

    def first_batch(self) -> tuple[list[PoseHypothesis], list[PoseHypothesis]]:
        """Find the first hypotheses, and the best one at other depths; both likeliest first."""
        candidates, agreement, modes, typical = self._modes(DEFAULT_HYPOTHESES)
        modes, columns = self._fitted(candidates, modes, typical)
        depths = depth_modes(candidates, self.landmarks, agreement)
        first = modes.take(np.zeros(len(depths.nearer), np.int64))
        others = replace(first, points_3d=moved_in_depth(modes.points_3d[0], depths.offsets))
        features = columns["features"][:1].repeat(len(others), axis=0)
        features[:, -1] = depths.nearer
        distances = columns["distance"][0] * np.exp(depths.misfits / DISTANCE_WEIGHT)
        alternative = {"distance": distances, **_by_features(features)}
        columns = {name: np.concatenate([one, alternative[name]]) for name, one in columns.items()}
        in_depth = np.arange(len(modes) + len(others)) >= len(modes)
        both = self.hypotheses(candidates, modes.append(others), in_depth=in_depth, **columns)
        return both[: len(modes)], likeliest_first(both[len(modes) :])

    def _fitted(
        self, candidates: Candidates, modes: Modes, typical: NDArray[np.bool_]
    ) -> tuple[Modes, dict[str, NDArray[np.float64]]]:
        """Modes fitted to the landmarks, likeliest first, and other fields of their hypotheses.

        The nearest is chosen before the fit, since a pose that must change far to fit is less
        likely; it follows the landmarks, and no other is said to be likelier. Their centres become
        the entries that look most like them: of the candidates ``(K,)`` that face as they do, one
        with the same silhouette, or else the typical one with the nearest.
        """
        agreement = self.landmarks.compare(modes.points_normalised, modes.points_3d)
        entries = candidates.take(modes.centres)
        _, tilt_deg = self.rotations(entries)
        distances = fused_distances(modes.distances, agreement, tilt_deg)
        order = np.argsort(distances, kind="stable")
        modes = modes.take(order)
        points_3d, placed = fit_to_landmarks(
            self.landmarks, modes.points_3d, modes.points_normalised
        )
        features = np.full((len(modes), len(LANDMARK_FEATURES)), np.nan)
        features[:, 0] = self.landmarks.reprojection_errors(entries.points_normalised[order])
        features[:, 1] = self.landmarks.reprojection_errors(placed)
        features[:, 2] = self.reliability
        columns = {"distance": distances[order], **_by_features(features)}
        columns["confidence"] = np.minimum(columns["confidence"], columns["confidence"][0])
        facing, front = (
            faces_camera(azimuth_deg(one)) for one in (candidates.points_3d, points_3d)
        )
        # The first is the nearest.
        # Largest distance at which an entry has the silhouette of the query: a shipped entry's is
        # stored at half resolution, 0.4 to 1.5 from its vector; people's are 3 or more from the
        # nearest.
        same = candidates.distances <= 2.0
        like = ((facing == front[:, None]) * (1 + 4 * same) + 2 * typical).argmax(axis=1)
        modes = replace(modes, centres=like, points_3d=points_3d, points_normalised=placed)
        order = np.argsort(-columns["confidence"], kind="stable")
        return modes.take(order), {name: one[order] for name, one in columns.items()}

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
            if self.landmarks.whole:
                found = find_candidates(self.index, queries, growth * _CANDIDATES)
                # Those that agree best with the landmarks make the modes.
                kept = self._likeliest(found, found.distances, growth * 100)
            else:
                found = sample_candidates(self.index, queries, growth * 1000)
                found = _placed_by_landmarks(found, self.landmarks)
                kept = self._likeliest(found, np.ones(len(found)), growth * 50)
            candidates, agreement, weights, typical = kept
            modes = find_modes(candidates, weights, n + SPARE_MODES, agreement.residuals)
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
        # Candidates that decide which action is the usual one, for each that is kept.
        typical = actions == np.bincount(actions[likeliest[: 3 * count]]).argmax()
        kept = np.sort(likeliest[:count])  # Back in ascending distance.
        return candidates.take(kept), agreement.take(kept), weights[kept], typical[kept]


def _by_features(features: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Fields of hypotheses with :data:`index.confidence.LANDMARK_FEATURES` ``(M, 4)``."""
    return {
        "features": features,
        "confidence": LANDMARK_CONFIDENCE.probability(features),
        "reprojection_error_px": features[:, 0],
    }


def _trunk_tilt_deg(limbs_3d: NDArray[np.float64]) -> float:
    """Clockwise tilt in the picture of the trunk of limbs ``(12, 3)``: 0 if upright."""
    hips, shoulders = (limbs_3d[pair].mean(axis=0) for pair in (LIMB_HIPS, LIMB_SHOULDERS))
    right, down, _ = (shoulders - hips).tolist()
    return float(np.rad2deg(np.arctan2(right, -down)))


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
    # Smallest scale at which candidates are placed by landmarks.
    placed = (plane - middle) * np.maximum(scale, 5.0)[:, None, None] + target
    return replace(candidates, points_normalised=placed)
