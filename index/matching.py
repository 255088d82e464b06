"""From a silhouette and an index to distinct hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.features import match_features
from index.keypoints import Keypoints, fit_to_keypoints
from index.modes import Modes, find_modes, mode_weights
from index.outline import outline_distances
from index.posture import POSTURES, Posture, camera_up, classify, lying_elevation_deg
from index.ranking import Ranking, fused_distances
from index.rotations import (
    RotatedQuery,
    compare_rotated_entries,
    find_rotated_candidates,
    rotations_of_landmarks,
    seen_from,
    usual_rotations,
)
from index.search import Nearest, rotate_clockwise
from index.skeleton import LIMBS, POINTS, mean_joint_distance, wrap_degrees
from index.store import PoseIndex

CANDIDATES, RANKED_CANDIDATES = 160, 200
"""Nearest entries considered without keypoints; more add few useful modes, of which a network that
ranks them finds a few more."""

SILHOUETTE_CANDIDATES, LANDMARK_CANDIDATES = 150, 50
"""With keypoints: entries nearest to each rotation of the silhouette, and to the landmarks."""

KEPT_CANDIDATES = 200
"""With keypoints: best candidates of both kinds, of which the modes are made."""

SPARE_MODES, SPARE_MODES_WITH_KEYPOINTS = 4, 4
"""Modes computed beyond those asked for: a sparse mode may fit best."""

MAX_STANDING_TILT_DEG = 30.0
"""Who seems tilted by more than this in the picture lies rather than stands."""

FIRST_HYPOTHESES = 7
"""Hypotheses are found in batches of this size, twice it, and so on, each after the one before, so
that the first k of n are those that are found where k are asked for."""

MAX_BATCH_GROWTH = 4
"""A batch this many times as large as the number asked for that adds nothing is the last: somebody
hardly seen may have few distinct poses, and looking for 50 took seconds."""

CANDIDATES_PER_HYPOTHESIS = 20
"""Candidates of one kind for each hypothesis asked for, at least."""

MAX_GROWTH = 16
"""Factor by which the number of candidates may grow where they hold too few distinct poses."""

DISTINCT_M = 0.055
"""Mean joint distance from which a hypothesis of a later batch is another than those before."""


_STANDS_DEG = 12.0
_LEAST_PX_PER_METRE = 5.0


@dataclass(frozen=True)
class Hypothesis:
    """A skeleton that may have cast the silhouette, and how well it fits.

    Parameters
    ----------
    entry : int
        The entry at the centre of those that agree on this pose.
    mirrored : bool
        Whether the hypothesis is the mirror image of that entry.
    distance : float
        Euclidean distance from the query's descriptor to the interpolated descriptor of the
        entries that agree on this pose.
    fused_distance : float
        The same, shorter where landmarks agree and longer where they disagree; without landmarks,
        longer where a network finds the joints unlikely, see
        :meth:`index.ranking.Ranking.distances`. Ascending.
    reprojection_error_px : float
        Mean distance between the outlines of the query and of the entry, averaged both ways, in
        pixels of the normalised frame.
    confidence : float
        Probability that the mean joint error in the normalised frame is below 5 px.
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    points_normalised : (24, 2) float64 array
        Pixels of the normalised frame.
    posture : str
        Of :data:`index.posture.POSTURES`.
    rotation_deg : float
        In-plane rotation of the entry, clockwise, in the picture of a camera that is not rolled;
        already applied to the points.
    tilt_deg : float
        The same and the roll of the entry's camera: the in-plane tilt of the person.
    adjusted_m : float
        Mean joint distance from the skeleton of the entry.
    """

    entry: int
    mirrored: bool
    distance: float
    reprojection_error_px: float
    confidence: float
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]
    posture: Posture = "standing"
    rotation_deg: float = 0.0
    tilt_deg: float = 0.0
    fused_distance: float = 0.0
    adjusted_m: float = 0.0

    def __post_init__(self) -> None:
        if self.points_3d.shape != (POINTS, 3) or self.points_normalised.shape != (POINTS, 2):
            raise ValueError(
                f"expected points of shapes ({POINTS}, 3) and ({POINTS}, 2), "
                f"got {self.points_3d.shape} and {self.points_normalised.shape}"
            )


@dataclass(frozen=True)
class Match:
    """The hypotheses of a silhouette, the nearest first.

    Parameters
    ----------
    hypotheses : list of Hypothesis
        Where no network has ranked them, usually a few more than asked for, for a caller who
        re-ranks them.
    features : (N, F) float64 array
        Of each, from which its confidence was computed: :data:`index.confidence.FEATURES`, or
        :data:`index.reranker.RERANKING_FEATURES`.
    first_batch : int
        How many of them there are however many are asked for.
    """

    hypotheses: list[Hypothesis]
    features: NDArray[np.float64]
    first_batch: int


def match(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    n: int,
    keypoints: Keypoints | None = None,
    *,
    roll_deg: float = 0.0,
    whole: bool = True,
) -> Match:
    """Find distinct poses that fit a silhouette, and landmarks if there are any.

    With landmarks, the entries nearest to them are candidates as well, candidates are weighted by
    their agreement with the landmarks, and the interpolated poses are fitted to them.

    Parameters
    ----------
    index : PoseIndex
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    n : int
        Number of hypotheses; fewer are returned where few distinct poses fit.
    keypoints : Keypoints, optional
    roll_deg : float
        Roll of the camera in the silhouette and the keypoints: not 0 where they were rotated
        because the silhouette is wider than high. Skeletons are returned as the camera sees them
        that is not rolled.
    whole : bool
        Whether the silhouette shows all of the body. Where it does not and landmarks are given,
        they alone choose the candidates, and place them.

    Returns
    -------
    Match
        The first ``k`` hypotheses do not depend on ``n``.
    """
    query = _Query(index, silhouette, keypoints, roll_deg, whole)
    batch = FIRST_HYPOTHESES
    found = query.match(batch)
    while len(found.hypotheses) < n or batch < n:
        batch *= 2
        more = query.match(batch)
        known = np.array([hypothesis.points_3d for hypothesis in found.hypotheses])
        later = [
            row
            for row, hypothesis in enumerate(more.hypotheses)
            if mean_joint_distance(hypothesis.points_3d[None], known).min() >= DISTINCT_M
        ]
        if not later and batch >= MAX_BATCH_GROWTH * n:
            break
        farthest = found.hypotheses[-1].fused_distance
        found = Match(
            found.hypotheses
            + [
                replace(one, fused_distance=max(one.fused_distance, farthest))
                for one in (more.hypotheses[row] for row in later)
            ],
            np.concatenate([found.features, more.features[later]]),
            found.first_batch,
        )
    return found


@dataclass(frozen=True)
class _Query:
    """What is asked of an index; see :func:`match`."""

    index: PoseIndex
    silhouette: NDArray[np.uint8]
    keypoints: Keypoints | None
    roll_deg: float
    whole: bool

    @cached_property
    def ranking(self) -> Ranking | None:
        """What the network makes of the silhouette; None with keypoints, or without a network."""
        if self.keypoints is not None or self.index.reranker is None:
            return None
        return Ranking.of(self.index.reranker, self.silhouette)

    def match(self, n: int) -> Match:
        """The hypotheses of one batch."""
        index, keypoints, roll_deg = self.index, self.keypoints, self.roll_deg
        wanted = CANDIDATES_PER_HYPOTHESIS * n
        rotations = usual_rotations(self.silhouette, roll_deg)
        ranking = self.ranking
        if keypoints is None:
            queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
            candidates, modes = _modes_of_silhouette(index, queries, n, wanted, ranking)
        else:
            queries, candidates, modes = self._modes_of_both(rotations, keypoints, n, wanted)
        fused = modes.distances if ranking is None else ranking.distances(modes)
        # Nobody re-ranks what the network has ranked, so the others need no features.
        nearest = np.argsort(fused, kind="stable")[: None if ranking is None else n]
        modes, fused = modes.take(nearest), fused[nearest]
        centres = candidates.take(modes.centres)
        errors = _outline_errors(index, queries, centres)
        features = match_features(candidates, modes, errors)
        if ranking is not None:
            features = ranking.features(features, modes, fused)
        confidences = index.calibration(reranked=ranking is not None).probability(features)
        rotation_deg = centres.rotation_deg - roll_deg
        tilt_deg = wrap_degrees(rotation_deg + index.roll_deg(centres.numbers, centres.mirrored))
        points_3d, points_normalised = modes.points_3d, modes.points_normalised
        order = np.arange(len(modes))
        if keypoints is not None:
            # Compared before the fit: a pose that has to change far to fit is less likely.
            agreement = keypoints.compare(points_normalised, points_3d)
            fused = fused_distances(modes.distances, agreement, tilt_deg)
            order = np.argsort(fused, kind="stable")
            points_3d, points_normalised = (
                fitted[np.argsort(order)]
                for fitted in fit_to_keypoints(
                    keypoints, points_3d[order], points_normalised[order]
                )
            )
        moved = mean_joint_distance(points_3d, centres.points_3d)
        points_3d = rotate_clockwise(points_3d, -roll_deg)
        postures = _postures(index, centres.numbers, points_3d, tilt_deg)
        hypotheses = [
            Hypothesis(
                entry=int(centres.numbers[row]),
                mirrored=bool(centres.mirrored[row]),
                distance=float(modes.distances[row]),
                reprojection_error_px=float(errors[row]),
                confidence=float(confidences[row]),
                points_3d=points_3d[row],
                points_normalised=points_normalised[row],
                posture=postures[row],
                rotation_deg=float(rotation_deg[row]),
                tilt_deg=float(tilt_deg[row]),
                fused_distance=float(fused[row]),
                adjusted_m=float(moved[row]),
            )
            for row in order
        ]
        return Match(hypotheses, features[order], len(hypotheses))

    def _modes_of_both(
        self, usual: Sequence[float], keypoints: Keypoints, n: int, wanted: int
    ) -> tuple[list[RotatedQuery], Candidates, Modes]:
        """Modes of the entries near the silhouette and of those near the landmarks."""
        index, growth = self.index, _growth(wanted)
        nearest, rotations = self._near_landmarks(keypoints, growth), list(usual)
        if nearest is not None:
            rotations = rotations_of_landmarks(usual, nearest.roll_deg)
        queries = [RotatedQuery.of(self.silhouette, rotation) for rotation in rotations]
        known = 0
        while True:
            parts = []
            if nearest is not None:
                parts.append(compare_rotated_entries(index, queries, nearest))
            if self.whole or nearest is None:
                k = growth * SILHOUETTE_CANDIDATES
                parts.append(find_rotated_candidates(index, queries, k))
            candidates = Candidates.merged(parts).unique()
            exhausted, known = len(candidates) <= known, len(candidates)
            if not self.whole:
                candidates = _placed_on(keypoints, candidates)
            agreement = keypoints.compare(candidates.points_normalised, candidates.points_3d)
            distances = candidates.distances if self.whole else np.ones(len(candidates))
            weights = mode_weights(distances, agreement)
            kept = np.argsort(-weights, kind="stable")[: growth * KEPT_CANDIDATES]
            kept.sort()  # Back in ascending distance.
            candidates, agreement = candidates.take(kept), agreement.take(kept)
            modes = find_modes(candidates, n + SPARE_MODES_WITH_KEYPOINTS, agreement=agreement)
            if len(modes) >= n or exhausted or growth >= MAX_GROWTH:
                return queries, candidates, modes
            growth *= 2
            nearest = self._near_landmarks(keypoints, growth)

    def _near_landmarks(self, keypoints: Keypoints, growth: int) -> Nearest | None:
        """Entries near the landmarks in three dimensions; None where there are none."""
        if keypoints.limbs_3d is None:
            return None
        limbs_3d = rotate_clockwise(keypoints.limbs_3d, -self.roll_deg)
        nearest = self.index.landmark_search.nearest(
            limbs_3d, likely_rolls(limbs_3d), growth * LANDMARK_CANDIDATES
        )
        return seen_from(self.index, nearest, self.roll_deg)


def _postures(
    index: PoseIndex,
    numbers: NDArray[np.int64],
    points_3d: NDArray[np.float64],
    tilt_deg: NDArray[np.float64],
) -> list[Posture]:
    """Postures of skeletons that were interpolated about entries; the camera is not rolled."""
    entries = index.entries[numbers]
    tilted = np.abs(tilt_deg) > MAX_STANDING_TILT_DEG
    elevation_deg = np.where(tilted, lying_elevation_deg(points_3d), entries["elevation_deg"])
    up = camera_up(elevation_deg)
    speeds = index.skeleton_labels["speed"][entries["skeleton"]]
    return [POSTURES[row] for row in classify(points_3d, up, speeds)]


def _modes_of_silhouette(
    index: PoseIndex,
    queries: Sequence[RotatedQuery],
    n: int,
    wanted: int,
    ranking: Ranking | None,
) -> tuple[Candidates, Modes]:
    """Increase the number of candidates until they hold ``n`` modes or the index has no more."""
    k = max(CANDIDATES if ranking is None else RANKED_CANDIDATES, wanted)
    while True:
        candidates = find_rotated_candidates(index, queries, k)
        if ranking is None:
            modes = find_modes(candidates, n + SPARE_MODES)
        else:
            support = ranking.support(candidates)
            modes = find_modes(candidates, n + SPARE_MODES, support=support, fit=ranking.fitted)
        if len(modes) >= n or len(candidates) < k or k >= MAX_GROWTH * CANDIDATES:
            return candidates, modes
        k *= 2


def likely_rolls(limbs_3d: NDArray[np.float64]) -> tuple[float, ...]:
    """Rolls of the camera that a person's limbs ``(12, 3)`` suggest: none, and the trunk's."""
    ends = [
        limbs_3d[[LIMBS.index(f"{side}_{part}") for side in ("left", "right")]].mean(axis=0)
        for part in ("hip", "shoulder")
    ]
    right, down, _ = (ends[1] - ends[0]).tolist()
    roll_deg = float(np.rad2deg(np.arctan2(right, -down)))
    return (0.0,) if abs(roll_deg) < _STANDS_DEG else (0.0, roll_deg)


def _placed_on(keypoints: Keypoints, candidates: Candidates) -> Candidates:
    """Candidates placed in the picture by the keypoints that are seen, by least squares."""
    rows = list(keypoints.rows)
    weights = (keypoints.scores / keypoints.scores.sum())[None, :, None]
    plane = candidates.points_3d[..., :2]
    middle = (weights * plane[:, rows]).sum(axis=1, keepdims=True)
    target = (weights[0] * keypoints.positions).sum(axis=0)
    from_middle = plane[:, rows] - middle
    to_keypoints = keypoints.positions - target
    scale = (weights * from_middle * to_keypoints).sum(axis=(1, 2)) / np.maximum(
        (weights * from_middle**2).sum(axis=(1, 2)), 1e-9
    )
    placed = (plane - middle) * np.maximum(scale, _LEAST_PX_PER_METRE)[:, None, None] + target
    return replace(candidates, points_normalised=placed)


def _growth(wanted: int) -> int:
    """Factor by which more candidates are needed than usual; at least 1."""
    return max(1, -(-wanted // SILHOUETTE_CANDIDATES))


def _outline_errors(
    index: PoseIndex, queries: Sequence[RotatedQuery], centres: Candidates
) -> NDArray[np.float64]:
    """Outline distances ``(M,)`` between the silhouettes of entries and the rotated query."""
    silhouettes = index.silhouettes(centres.numbers)
    silhouettes[centres.mirrored] = silhouettes[centres.mirrored, :, ::-1]
    errors = np.empty(len(centres))
    for query in queries:
        rows = centres.rotation_deg == query.rotation_deg
        if rows.any():
            errors[rows] = outline_distances(query.silhouette, silhouettes[rows])
    return errors
