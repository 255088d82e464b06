"""From a silhouette, and landmarks if there are any, to distinct poses in the order of their rank.

Entries near the query are candidates; poses at which they gather are modes. Hypotheses are modes in
the order of their distances, with a confidence. With landmarks, the entries nearest to them are
candidates as well, candidates are weighted by their agreement with them, modes are fitted to them,
and both facings are among the hypotheses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import outline_distances
from index.candidates import (
    Candidates,
    RotatedQuery,
    find_candidates,
    landmark_rotations,
    silhouette_rotations,
)
from index.confidence import RIGHT_BELOW_PX, fused_confidences
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
from index.modes import (
    DepthModes,
    Modes,
    candidate_weights,
    depth_modes,
    find_modes,
    mode_weights,
)
from index.posture import POSTURES, PostureName, camera_up, classify_postures, lying_elevation_deg
from index.ranking import NetworkRanking
from index.search import NearestEntries
from index.skeleton import (
    JOINTS,
    LIMB_HIPS,
    LIMB_SHOULDERS,
    POINTS,
    mean_joint_distance,
    moved_in_depth,
    rotate_clockwise,
    wrap_degrees,
)
from index.store import PoseIndex

DEFAULT_HYPOTHESES = 7
"""Hypotheses returned unless a caller asks for another number; the confidence is fitted for them,
and this many decide posture and facing however many are requested. They are the first batch; the
next one is twice as large, and so on, so that the first k of n are those found when k are
requested."""

MIN_NEW_POSE_M = 0.055
"""Mean joint distance from all earlier hypotheses that makes one of a later batch new."""

# If a batch of this many times the number requested adds nothing, it is the last: few distinct
# poses may fit a person who is hardly seen, and looking for 50 took seconds.
_MAX_BATCH_GROWTH = 4

SPARE_MODES = 4
"""Modes computed beyond those requested: a sparse mode may fit best."""


@dataclass(frozen=True)
class PoseHypothesis:
    """A skeleton that may have cast the silhouette, and how well it fits.

    Parameters
    ----------
    entry_id : int
        The entry at the centre of the entries that agree on this pose.
    mirrored : bool
        Whether the hypothesis is the mirror image of that entry.
    silhouette_distance : float
        Euclidean distance from the query's descriptor to the interpolated descriptor of the
        entries that agree on this pose.
    confidence : float
        Probability that the mean joint error in the normalised frame is below 5 px; see
        :mod:`index.confidence`.
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    points_normalised : (24, 2) float64 array
        Pixels of the normalised frame.
    posture : str
        One of :data:`index.posture.POSTURES`.
    rotation_deg : float
        In-plane rotation of the entry, clockwise, in the picture of a camera that is not rolled;
        already applied to the points.
    tilt_deg : float
        ``rotation_deg`` plus the roll of the entry's camera: the in-plane tilt of the person.
    distance : float
        The silhouette distance, shortened or lengthened by the agreement with landmarks or, without
        landmarks, lengthened if a network finds the joints unlikely; see :mod:`index.ranking`.
    adjusted_m : float
        Mean joint distance from the skeleton of the entry.
    weight : float or None
        Probability that this hypothesis is nearer to the truth than all others of the first
        :data:`DEFAULT_HYPOTHESES`; 0 for later ones, None without landmarks.
    outline_distance_px : float
        Mean distance between the outlines of the query and of the entry, averaged both ways, in
        pixels of the normalised frame; not a number of those that only vote.
    """

    entry_id: int
    mirrored: bool
    silhouette_distance: float
    confidence: float
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]
    posture: PostureName = "standing"
    rotation_deg: float = 0.0
    tilt_deg: float = 0.0
    distance: float = 0.0
    adjusted_m: float = 0.0
    weight: float | None = None
    outline_distance_px: float = math.nan

    def __post_init__(self) -> None:
        if self.points_3d.shape != (POINTS, 3) or self.points_normalised.shape != (POINTS, 2):
            raise ValueError(
                f"expected points of shapes ({POINTS}, 3) and ({POINTS}, 2), "
                f"got {self.points_3d.shape} and {self.points_normalised.shape}"
            )


@dataclass(frozen=True)
class Match:
    """The hypotheses of a silhouette, in the order of their rank.

    Parameters
    ----------
    hypotheses : list of PoseHypothesis
        With ascending distances. With landmarks, some face the opposite way to the first, and a
        nearer one after such a hypothesis gets its distance.
    features : (N, F) float64 array
        Features from which the confidences were computed: :data:`index.confidence.FEATURES`, or
        :data:`index.confidence.RERANKING_FEATURES`; none with landmarks.
    front_probability : float
        Probability that the camera sees the person from the front: the confidence of hypotheses
        that face it, as a share of the confidence of all. It does not depend on how many were
        requested.
    voters : list of PoseHypothesis
        Those that decide the posture, likewise: modes, but no alternatives in depth.
    """

    hypotheses: list[PoseHypothesis]
    features: NDArray[np.float64]
    front_probability: float
    voters: list[PoseHypothesis]


def match(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    n: int,
    landmarks: NormalisedLandmarks | None = None,
    *,
    roll_deg: float = 0.0,
    whole: bool = True,
) -> Match:
    """Find distinct poses that fit a silhouette, and landmarks if there are any.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    n : int
        Number of hypotheses. At least :data:`DEFAULT_HYPOTHESES` are returned, for posture and
        facing, but fewer than either if few distinct poses fit.
    roll_deg : float
        Roll of the camera in the silhouette and the landmarks; not 0 if they were rotated because
        the silhouette is wider than high. Skeletons are returned in the axes of the camera without
        that roll.
    whole : bool
        Whether the silhouette shows the whole body. If not, landmarks alone choose and place the
        candidates.

    Returns
    -------
    Match
        The first ``k`` hypotheses do not depend on ``n``.
    """
    query = _Query(index, silhouette, landmarks, roll_deg, whole)
    size = DEFAULT_HYPOTHESES
    found, features, alternatives = query.batch(size)
    voters = found[: DEFAULT_HYPOTHESES if landmarks is None else None]
    voters_deg = azimuth_deg(np.array([one.points_3d for one in voters]))
    votes = np.array([one.confidence for one in voters])
    front_probability = front_share(voters_deg, votes)
    # For each rank, the number of hypotheses found for a request of that many.
    pools = [len(found)] * min(size, len(found))
    if landmarks is not None:
        found, weighted = _weighted(found, alternatives, front_probability)
        features = np.empty((len(found), 0))
        pools = [1] + [weighted] * (min(size, weighted) - 1)
        pools += [len(found)] * (min(size, len(found)) - len(pools))
    while len(found) < n or size < n:
        size *= 2
        later, later_features, _ = query.batch(size, at_least=found[-1].distance)
        new = _unlike(later, found)
        if not new and size >= _MAX_BATCH_GROWTH * n:
            break
        found = found + [later[row] for row in new]
        features = np.concatenate([features, later_features[new]])
        pools += [len(found)] * (min(size, len(found)) - len(pools))
    count = max(n, DEFAULT_HYPOTHESES)
    if landmarks is None:
        return Match(found[:count], features[:count], front_probability, voters)
    azimuths = azimuth_deg(np.array([one.points_3d for one in found]))
    # A skeleton cannot be likelier right than its heading.
    shares = heading_shares(azimuths, voters_deg, votes)
    confidences = np.minimum([one.confidence for one in found], shares)
    distances = np.array([one.distance for one in found])
    chosen = nearest_of_both_facings(azimuths, distances, front_probability, pools[:count])
    ascending = np.maximum.accumulate(distances[chosen])
    returned = [found[row] for row in chosen]
    outline_px = query.outline_distances(
        np.array([one.entry_id for one in returned]),
        np.array([one.mirrored for one in returned]),
        np.array([one.rotation_deg for one in returned]) + roll_deg,
    )
    hypotheses = [
        replace(
            one,
            distance=distance,
            confidence=confidence,
            weight=one.weight or 0.0,
            outline_distance_px=pixels,
        )
        for one, distance, confidence, pixels in zip(
            returned,
            ascending.tolist(),
            confidences[chosen].tolist(),
            outline_px.tolist(),
            strict=True,
        )
    ]
    return Match(hypotheses, features[chosen], front_probability, voters)


def _weighted(
    modes: Sequence[PoseHypothesis],
    alternatives: Sequence[PoseHypothesis],
    front_probability: float,
) -> tuple[list[PoseHypothesis], int]:
    """Weigh what is found with landmarks: the best mode, its alternatives, those that face away.

    Returns
    -------
    hypotheses : list of PoseHypothesis
        In this order; other modes follow, of weight 0, if they differ from all of these.
    weighted : int
        Number of those before.
    """
    front = faces_camera(azimuth_deg(np.array([one.points_3d for one in modes])))
    facing, away = ([one for one, f in zip(modes, front, strict=True) if f == which]
                    for which in (front[0], not front[0]))  # fmt: skip
    share = front_probability if front[0] else 1 - front_probability
    votes = sum(one.confidence for one in away) + 1e-9
    rest = 1 - sum(one.weight or 0.0 for one in alternatives)
    weighted = [
        replace(facing[0], weight=share * rest),
        *(replace(one, weight=share * (one.weight or 0.0)) for one in alternatives),
        *(replace(one, weight=(1 - share) * one.confidence / votes) for one in away),
    ]
    new = _unlike(facing[1:], weighted)
    return weighted + [facing[1 + row] for row in new], len(weighted)


def _unlike(others: Sequence[PoseHypothesis], known: Sequence[PoseHypothesis]) -> list[int]:
    """Rows of the hypotheses that are new poses, unlike all that are known."""
    if not others:
        return []
    poses, earlier = (np.array([one.points_3d for one in some]) for some in (others, known))
    nearest = mean_joint_distance(poses[:, None], earlier).min(axis=1)
    return np.flatnonzero(nearest >= MIN_NEW_POSE_M).tolist()


# Number of nearest entries without landmarks; more add few useful modes. A network that ranks the
# modes can use a few more.
_CANDIDATES, _RANKED_CANDIDATES = 160, 200
# With landmarks: number of entries nearest to each rotation of the silhouette, number of entries
# nearest to the landmarks, and number of the best of both, from which the modes are made.
_SILHOUETTE_CANDIDATES, _LANDMARK_CANDIDATES, _KEPT_CANDIDATES = 150, 50, 200
# Fewest candidates of one kind for each hypothesis requested.
_CANDIDATES_PER_HYPOTHESIS = 20
# Factor by which the candidates may grow if they hold too few distinct poses.
_MAX_CANDIDATE_GROWTH = 16
# A person tilted by more than this in the picture is lying rather than standing.
_MAX_STANDING_TILT_DEG = 30.0


_Found = tuple[Candidates, Modes, DepthModes | None]
"""Candidates and their modes; with landmarks, depths in the first batch."""


@dataclass(frozen=True)
class _Query:
    """One silhouette with its evidence and the index to search; see :func:`match`."""

    index: PoseIndex
    silhouette: NDArray[np.uint8]
    landmarks: NormalisedLandmarks | None
    roll_deg: float
    whole: bool

    @cached_property
    def ranking(self) -> NetworkRanking | None:
        """The network's ranking; None with landmarks, or without a network."""
        if self.landmarks is not None or self.index.reranker is None:
            return None
        return NetworkRanking.of(self.index.reranker, self.silhouette)

    def batch(
        self, n: int, at_least: float = 0.0
    ) -> tuple[list[PoseHypothesis], NDArray[np.float64], list[PoseHypothesis]]:
        """Find about ``n`` hypotheses, nearest first, and the features of their confidences.

        No distance is smaller than ``at_least``, the distance of the last one of earlier batches.
        In the first batch, if there are landmarks, also alternatives to the best, nearest first.
        """
        index, ranking, landmarks = self.index, self.ranking, self.landmarks
        candidates, modes, depths = (
            self._modes_of_silhouette(n)
            if landmarks is None
            else self._modes_with_landmarks(n, landmarks)
        )
        distances = modes.distances
        if landmarks is not None:
            # Modes are compared before the fit: a pose that must change far to fit is less likely.
            agreement = landmarks.compare(modes.points_normalised, modes.points_3d)
            _, tilt_deg = self._rotations(candidates.take(modes.centres))
            distances = fused_distances(distances, agreement, tilt_deg)
        elif ranking is not None:
            distances = ranking.distances(modes)
        # What the network has ranked is not re-ranked later, so no spare modes are needed.
        nearest = np.argsort(distances, kind="stable")[: None if ranking is None else n]
        modes, distances = modes.take(nearest), distances[nearest]
        # The entries of the modes, then those of the alternatives.
        rows = modes.centres if depths is None else np.concatenate([modes.centres, depths.rows])
        entries = candidates.take(rows)
        rotation_deg, tilt_deg = self._rotations(entries)
        outline_px = np.full(len(entries), np.nan)
        if landmarks is None:
            outline_px = self.outline_distances(
                entries.entry_ids, entries.mirrored, entries.rotation_deg
            )
            features = _features(candidates, modes, outline_px)
            if ranking is not None:
                features = ranking.features(features, modes, distances)
        else:
            points_3d, points_normalised = fit_to_landmarks(
                landmarks, modes.points_3d, modes.points_normalised
            )
            modes = replace(modes, points_3d=points_3d, points_normalised=points_normalised)
            features = np.empty((len(modes), 0))
        distances = np.maximum(distances, at_least)
        points_3d, points_normalised = modes.points_3d, modes.points_normalised
        silhouette_distances = modes.distances
        weights: list[float | None] = [None] * len(modes)
        if depths is not None:
            # The best hypothesis at other depths.
            more = len(depths.rows)
            points_3d = np.concatenate([points_3d, moved_in_depth(points_3d[0], depths.offsets)])
            points_normalised = np.concatenate(
                [points_normalised, np.repeat(points_normalised[:1], more, axis=0)]
            )
            silhouette_distances = entries.distances.copy()
            silhouette_distances[: len(modes)] = modes.distances
            farther = np.exp(depths.misfits / DISTANCE_WEIGHT)
            distances = np.concatenate([distances, distances[0] * farther])
            weights += depths.shares.tolist()
        adjusted_m = mean_joint_distance(points_3d, entries.points_3d)
        points_3d = rotate_clockwise(points_3d, -self.roll_deg)
        if landmarks is None:
            confidences = index.calibration(reranked=ranking is not None).probability(features)
        else:
            confidences = fused_confidences(distances, adjusted_m)
            confidences[len(modes) :] = confidences[0]
        hypotheses = [
            PoseHypothesis(*values)
            for values in zip(
                entries.entry_ids.tolist(),
                entries.mirrored.tolist(),
                silhouette_distances.tolist(),
                confidences.tolist(),
                points_3d,
                points_normalised,
                self._postures(entries.entry_ids, points_3d, tilt_deg),
                rotation_deg.tolist(),
                tilt_deg.tolist(),
                distances.tolist(),
                adjusted_m.tolist(),
                weights,
                outline_px.tolist(),
                strict=True,
            )
        ]
        found, alternatives = hypotheses[: len(modes)], hypotheses[len(modes) :]
        return found, features, sorted(alternatives, key=lambda one: one.distance)

    def _rotations(self, centres: Candidates) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotations of candidates ``(M,)`` for a camera that is not rolled, and their tilts."""
        rotation_deg = centres.rotation_deg - self.roll_deg
        entry_roll_deg = self.index.roll_deg(centres.entry_ids, centres.mirrored)
        return rotation_deg, wrap_degrees(rotation_deg + entry_roll_deg)

    def outline_distances(
        self,
        entry_ids: NDArray[np.int64],
        mirrored: NDArray[np.bool_],
        rotation_deg: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Outline distances ``(M,)`` of entries, as rotated in the frame of the silhouette."""
        silhouettes = self.index.silhouettes(entry_ids)
        silhouettes[mirrored] = silhouettes[mirrored, :, ::-1]
        distances = np.empty(len(entry_ids))
        for rotation in np.unique(rotation_deg).tolist():
            query, rows = RotatedQuery.of(self.silhouette, rotation), rotation_deg == rotation
            distances[rows] = outline_distances(query.silhouette, silhouettes[rows])
        return distances

    def _modes_of_silhouette(self, n: int) -> _Found:
        """Take more and more candidates until they have ``n`` modes or the index has no more."""
        ranking = self.ranking
        rotations = silhouette_rotations(self.silhouette, self.roll_deg)
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        usual = _CANDIDATES if ranking is None else _RANKED_CANDIDATES
        k = max(usual, _CANDIDATES_PER_HYPOTHESIS * n)
        while True:
            candidates = find_candidates(self.index, queries, k)
            count = n + SPARE_MODES
            if ranking is None:
                modes = find_modes(candidates, count)
            else:
                support = ranking.support(candidates)
                modes = find_modes(candidates, count, support=support, fit=ranking.fit)
            exhausted = len(candidates) < k
            if len(modes) >= n or exhausted or k >= _MAX_CANDIDATE_GROWTH * _CANDIDATES:
                return candidates, modes, None
            k *= 2

    def _modes_with_landmarks(self, n: int, landmarks: NormalisedLandmarks) -> _Found:
        """Modes of candidates near the silhouette and the landmarks, weighted by agreement.

        Unless the silhouette is whole, only entries near the landmarks are candidates.
        """
        growth = max(1, math.ceil(_CANDIDATES_PER_HYPOTHESIS * n / _SILHOUETTE_CANDIDATES))
        nearest = self._near_landmarks(landmarks, growth)
        usual = silhouette_rotations(self.silhouette, self.roll_deg)
        rotations = landmark_rotations(usual, nearest.roll_deg)
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        known = 0
        while True:
            k = growth * _SILHOUETTE_CANDIDATES if self.whole else 0
            candidates = find_candidates(self.index, queries, k, nearest)
            exhausted, known = len(candidates) <= known, len(candidates)
            candidates, agreement = self._likeliest(
                candidates, landmarks, growth * _KEPT_CANDIDATES
            )
            modes = find_modes(candidates, n + SPARE_MODES, agreement=agreement)
            if len(modes) >= n or exhausted or growth >= _MAX_CANDIDATE_GROWTH:
                break
            growth *= 2
            nearest = self._near_landmarks(landmarks, growth)
        depths = None
        if n == DEFAULT_HYPOTHESES:
            depths = depth_modes(candidates, landmarks, agreement, n - 2)
        return candidates, modes, depths

    def _near_landmarks(self, landmarks: NormalisedLandmarks, growth: int) -> NearestEntries:
        """Entries near the landmarks in three dimensions, with their rotations in the query."""
        limbs_3d = rotate_clockwise(landmarks.limbs_3d, -self.roll_deg)
        nearest = self.index.landmark_search.nearest(
            limbs_3d, _likely_rolls(limbs_3d), growth * _LANDMARK_CANDIDATES
        )
        entry_roll_deg = self.index.roll_deg(nearest.entry_ids, nearest.mirrored)
        return replace(nearest, roll_deg=nearest.roll_deg - entry_roll_deg + self.roll_deg)

    def _likeliest(
        self, candidates: Candidates, landmarks: NormalisedLandmarks, count: int
    ) -> tuple[Candidates, Agreement]:
        """Candidates with the largest weights, ordered by distance, with their agreement."""
        if not self.whole:
            candidates = _placed_by_landmarks(candidates, landmarks)
        agreement = landmarks.compare(candidates.points_normalised, candidates.points_3d)
        distances = candidates.distances if self.whole else np.ones(len(candidates))
        kept = np.argsort(-mode_weights(distances, agreement), kind="stable")[:count]
        kept.sort()  # Back in ascending distance.
        return candidates.take(kept), agreement.take(kept)

    def _postures(
        self,
        entry_ids: NDArray[np.int64],
        points_3d: NDArray[np.float64],
        tilt_deg: NDArray[np.float64],
    ) -> list[PostureName]:
        """Postures of skeletons interpolated about entries, in a camera that is not rolled."""
        entries = self.index.entries[entry_ids]
        tilted = np.abs(tilt_deg) > _MAX_STANDING_TILT_DEG
        elevation_deg = np.where(tilted, lying_elevation_deg(points_3d), entries["elevation_deg"])
        speeds = self.index.skeleton_labels["speed"][entries["skeleton"]]
        return [
            POSTURES[row] for row in classify_postures(points_3d, camera_up(elevation_deg), speeds)
        ]


# Landmarks whose trunk is tilted by less are searched only as they are.
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


# Mean joint distances below which a candidate agrees with a mode.
_AGREEMENT_PX = (RIGHT_BELOW_PX, 2 * RIGHT_BELOW_PX)
# Fall-offs of the candidates' weights, as in :func:`index.modes.candidate_weights`.
_AGREEMENT_FALL_OFFS = (0.15, 0.5)


def _features(
    candidates: Candidates, modes: Modes, outline_errors: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute :data:`index.confidence.FEATURES`.

    Parameters
    ----------
    modes : Modes
        M modes of the candidates, ordered by rank.
    outline_errors : (M,) array
        Outline distance between the query and the centre of each mode, pixels.

    Returns
    -------
    (M, F) float64 array
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
            np.asarray(outline_errors, np.float64),
            np.log(np.arange(1, len(modes) + 1)),
            *np.log(_agreements(candidates, modes) + 1e-3),
        ],
        axis=-1,
    )


def _agreements(candidates: Candidates, modes: Modes) -> NDArray[np.float64]:
    """Weighted shares ``(4, M)`` of the candidates that agree with each mode.

    The share of candidates that agree with a hypothesis is a better predictor of its being right
    than the fit of the hypothesis itself.
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
