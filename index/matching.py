"""From a silhouette and an index to distinct hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from index.candidates import Candidates
from index.features import match_features
from index.keypoint_fit import fit_to_keypoints
from index.keypoints import Keypoints
from index.modes import Modes, find_modes, mode_weights
from index.outline import outline_distances
from index.posture import POSTURES, Posture, camera_up, classify, lying_elevation_deg
from index.reranking import Ranking
from index.rotations import (
    RotatedQuery,
    compare_rotated_entries,
    find_rotated_candidates,
    likely_rotations,
    rotate_clockwise,
    seen_from,
    usual_rotations,
)
from index.skeleton import POINTS, wrap_degrees
from index.store import PoseIndex

CANDIDATES, RANKED_CANDIDATES = 160, 200
"""Nearest entries considered without keypoints; more add few useful modes, of which a network that
ranks them finds a few more."""

SILHOUETTE_CANDIDATES, KEYPOINT_CANDIDATES = 150, 150
"""With keypoints: entries nearest to each rotation of the silhouette, and to the keypoints."""

KEPT_CANDIDATES = 200
"""With keypoints: best candidates of both kinds, of which the modes are made."""

SPARE_MODES, SPARE_MODES_WITH_KEYPOINTS = 4, 9
"""Modes computed beyond those asked for: a sparse mode may fit best."""

MAX_LEAN_DEG = 30.0
"""Who seems tilted by more than this in the picture lies rather than stands."""

CANDIDATES_PER_HYPOTHESIS = 20
MAX_GROWTH = 16
"""Factor by which the number of candidates may grow where they hold too few distinct poses."""


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
        entries that agree on this pose; without keypoints, made longer by a network that finds the
        joints unlikely, see :meth:`index.reranking.Ranking.distances`.
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
        Clockwise rotation of the entry in the upright picture, already applied to the points.
    tilt_deg : float
        The same and the roll of the entry's camera: how askew the person would have to be seen.
    log_likelihood, side_odds : float
        Agreement with the keypoints, and log odds against left and right exchanged; see
        :class:`index.keypoints.Agreement`. 0 without keypoints.
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
    log_likelihood: float = 0.0
    side_odds: float = 0.0

    def __post_init__(self) -> None:
        if self.points_3d.shape != (POINTS, 3) or self.points_normalised.shape != (POINTS, 2):
            raise ValueError(
                f"expected points of shapes ({POINTS}, 3) and ({POINTS}, 2), "
                f"got {self.points_3d.shape} and {self.points_normalised.shape}"
            )


@dataclass(frozen=True)
class Match:
    """The hypotheses of a silhouette, in ascending distance.

    Parameters
    ----------
    hypotheses : list of Hypothesis
        Where no network has ranked them, usually a few more than asked for, for a caller who
        re-ranks them.
    features : (N, F) float64 array
        Of each, from which its confidence was computed: :data:`index.confidence.FEATURES`, or
        :data:`index.reranker.RERANKING_FEATURES`.
    """

    hypotheses: list[Hypothesis]
    features: NDArray[np.float64]


def match(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    n: int,
    keypoints: Keypoints | None = None,
    *,
    roll_deg: float = 0.0,
    candidates_per_hypothesis: int = CANDIDATES_PER_HYPOTHESIS,
) -> Match:
    """Find distinct poses that fit a silhouette, and keypoints if there are any.

    With keypoints, the entries nearest to them are candidates as well, likely rotations are
    searched, candidates are weighted by their agreement with the keypoints, and the interpolated
    poses are fitted to the keypoints.

    Parameters
    ----------
    index : PoseIndex
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    n : int
        Number of hypotheses; fewer are returned only where the index has fewer distinct poses.
    keypoints : Keypoints, optional
    roll_deg : float
        Roll of the camera in the silhouette and the keypoints: not 0 where they were rotated
        because the silhouette is wider than high. Skeletons are returned as the camera sees them
        that is not rolled.
    candidates_per_hypothesis : int
        Fewer take less time where many hypotheses are wanted: each stands for fewer entries.

    Returns
    -------
    Match
    """
    rotations = usual_rotations(silhouette, roll_deg)
    wanted = candidates_per_hypothesis * n
    ranking = None
    if keypoints is None:
        if index.reranker is not None:
            ranking = Ranking.of(index.reranker, silhouette)
        queries = [RotatedQuery.of(silhouette, rotation) for rotation in rotations]
        candidates, modes = _modes_of_silhouette(index, queries, n, wanted, ranking)
    else:
        nearest = index.keypoint_search.nearest(
            keypoints.rotated(-roll_deg), _growth(wanted) * KEYPOINT_CANDIDATES
        )
        nearest = seen_from(index, nearest, roll_deg)
        likely = [r for r in likely_rotations(nearest.roll_deg) if r not in rotations]
        queries = [RotatedQuery.of(silhouette, rotation) for rotation in (*rotations, *likely)]
        by_keypoints = compare_rotated_entries(index, queries, nearest)
        candidates, modes = _modes_of_both(index, queries, by_keypoints, keypoints, n, wanted)
    distances = modes.distances if ranking is None else ranking.distances(modes)
    # Nobody re-ranks what the network has ranked, so the others need no features.
    order = np.argsort(distances, kind="stable")[: None if ranking is None else n]
    modes, distances = modes.take(order), distances[order]
    centres = candidates.take(modes.centres)
    errors = _outline_errors(index, queries, centres)
    features = match_features(candidates, modes, errors)
    if ranking is not None:
        features = ranking.features(features, modes, distances)
    confidences = index.calibration(reranked=ranking is not None).probability(features)
    points_3d, points_normalised = modes.points_3d, modes.points_normalised
    log_likelihood = side_odds = np.zeros(len(modes))
    if keypoints is not None:
        # Compared before the fit: a pose that has to change far to fit is less likely.
        agreement = keypoints.compare(points_normalised)
        log_likelihood, side_odds = agreement.log_likelihood, agreement.side_odds
        points_3d, points_normalised = fit_to_keypoints(keypoints, points_3d, points_normalised)
    points_3d = rotate_clockwise(points_3d, -roll_deg)
    rotation_deg = centres.rotation_deg - roll_deg
    tilt_deg = wrap_degrees(rotation_deg + index.roll_deg(centres.numbers, centres.mirrored))
    postures = _postures(index, centres.numbers, points_3d, tilt_deg)
    hypotheses = [
        Hypothesis(
            entry=int(centres.numbers[row]),
            mirrored=bool(centres.mirrored[row]),
            distance=float(distances[row]),
            reprojection_error_px=float(errors[row]),
            confidence=float(confidences[row]),
            points_3d=points_3d[row],
            points_normalised=points_normalised[row],
            posture=postures[row],
            rotation_deg=float(rotation_deg[row]),
            tilt_deg=float(tilt_deg[row]),
            log_likelihood=float(log_likelihood[row]),
            side_odds=float(side_odds[row]),
        )
        for row in range(len(modes))
    ]
    return Match(hypotheses, features)


def _postures(
    index: PoseIndex,
    numbers: NDArray[np.int64],
    points_3d: NDArray[np.float64],
    tilt_deg: NDArray[np.float64],
) -> list[Posture]:
    """Postures of skeletons that were interpolated about entries, seen by an upright camera."""
    entries = index.entries[numbers]
    tilted = np.abs(tilt_deg) > MAX_LEAN_DEG
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
        support = None if ranking is None else ranking.support(candidates)
        modes = find_modes(candidates, n + SPARE_MODES, support=support)
        if len(modes) >= n or len(candidates) < k or k >= MAX_GROWTH * CANDIDATES:
            return candidates, modes
        k *= 2


def _modes_of_both(
    index: PoseIndex,
    queries: Sequence[RotatedQuery],
    by_keypoints: Candidates,
    keypoints: Keypoints,
    n: int,
    wanted: int,
) -> tuple[Candidates, Modes]:
    """As :func:`_modes_of_silhouette`, with candidates near the keypoints as well."""
    growth = _growth(wanted)
    while True:
        by_silhouette = find_rotated_candidates(index, queries, growth * SILHOUETTE_CANDIDATES)
        candidates = Candidates.merged([by_silhouette, by_keypoints]).unique()
        agreement = keypoints.compare(candidates.points_normalised)
        weights = mode_weights(candidates.distances, agreement)
        kept = np.argsort(-weights, kind="stable")[: growth * KEPT_CANDIDATES]
        kept.sort()  # Back in ascending distance.
        candidates, agreement = candidates.take(kept), agreement.take(kept)
        modes = find_modes(candidates, n + SPARE_MODES_WITH_KEYPOINTS, agreement=agreement)
        exhausted = len(candidates) < growth * KEPT_CANDIDATES
        if len(modes) >= n or exhausted or growth >= MAX_GROWTH:
            return candidates, modes
        growth *= 2


def _growth(wanted: int) -> int:
    """Factor by which more candidates are needed than usual; at least 1."""
    return max(1, -(-wanted // SILHOUETTE_CANDIDATES))


def _outline_errors(
    index: PoseIndex, queries: Sequence[RotatedQuery], centres: Candidates
) -> NDArray[np.float64]:
    """Outline distances ``(M,)`` between the silhouettes of entries and the query, upright."""
    silhouettes = index.silhouettes(centres.numbers)
    silhouettes[centres.mirrored] = silhouettes[centres.mirrored, :, ::-1]
    errors = np.empty(len(centres))
    for query in queries:
        rows = centres.rotation_deg == query.rotation_deg
        if rows.any():
            errors[rows] = outline_distances(query.upright, silhouettes[rows])
    return errors
