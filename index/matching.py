"""A silhouette and an index to distinct hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH
from index.candidates import Candidates
from index.confidence import RIGHT_BELOW_PX, Calibration
from index.keypoint_fit import fit_to_keypoints
from index.keypoints import Keypoints
from index.leans import (
    Leaning,
    find_leaning_candidates,
    leaning_candidates_of,
    likely_leans,
    turned_clockwise,
)
from index.modes import Modes, candidate_weights, find_modes, mode_weights
from index.skeleton import JOINTS, POINTS
from index.store import PoseIndex

CANDIDATES = 160
"""Nearest entries that are looked at by the silhouette alone; of more, few add a mode worth
offering."""

SPARE_MODES = 4
"""Modes looked at beyond those asked for, by the silhouette alone: a thin one may fit best."""

BY_SILHOUETTE, BY_KEYPOINTS, KEPT = 150, 150, 200
"""With keypoints: nearest entries by the silhouette for each lean, by the keypoints, and how many
of all these the modes are made of."""

SPARE_MODES_SEEN = 9
"""With keypoints, modes looked at beyond those asked for: one may agree best with the keypoints."""

AGREEMENT_PX = (RIGHT_BELOW_PX, 2 * RIGHT_BELOW_PX)
AGREEMENT_FALL_OFFS = (0.15, 0.5)
"""How near candidates must come to a hypothesis, and how fast they count less with distance."""


@dataclass(frozen=True)
class Hypothesis:
    """One answer to a silhouette: a skeleton and how well it fits.

    Parameters
    ----------
    entry : int
        The entry in the middle of those that agree on this pose.
    mirrored : bool
        Whether it is the mirror image of that entry.
    distance : float
        Euclidean distance from the query's descriptor to those of the entries that agree on
        this pose, interpolated.
    reprojection_error_px : float
        Mean distance between the outlines of the query and of the entry, both ways, in the
        normalised frame.
    confidence : float
        Probability that the mean joint error in the normalised frame is below 5 px.
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    points_normalised : (24, 2) float64 array
        The same in pixels of the normalised frame.
    lean_deg : float
        How far the entry is turned clockwise in the picture.
    log_likelihood, side_odds : float
        Agreement with the keypoints, and how much better it is than with left and right exchanged;
        see :class:`index.keypoints.Agreement`. 0 without keypoints.
    """

    entry: int
    mirrored: bool
    distance: float
    reprojection_error_px: float
    confidence: float
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]
    lean_deg: float = 0.0
    log_likelihood: float = 0.0
    side_odds: float = 0.0

    def __post_init__(self) -> None:
        if self.points_3d.shape != (POINTS, 3) or self.points_normalised.shape != (POINTS, 2):
            raise ValueError(
                f"expected points of shapes ({POINTS}, 3) and ({POINTS}, 2), "
                f"got {self.points_3d.shape} and {self.points_normalised.shape}"
            )


def leaning_further(hypothesis: Hypothesis, angle_deg: float) -> Hypothesis:
    """Turn a hypothesis clockwise in the picture; its normalised frame stays upright."""
    return replace(
        hypothesis,
        points_3d=turned_clockwise(hypothesis.points_3d, angle_deg),
        lean_deg=hypothesis.lean_deg + angle_deg,
    )


def match(index: PoseIndex, silhouette: NDArray[np.uint8], n: int) -> list[Hypothesis]:
    """Find the best distinct poses, in ascending distance.

    Parameters
    ----------
    index : PoseIndex
    silhouette : (128, 48) uint8 array
        Normalised; 1 on the person, 0 elsewhere.
    n : int
        How many; fewer are returned only where the index has fewer distinct poses.

    Returns
    -------
    list of Hypothesis
    """
    return match_with_spares(index, silhouette, n)[:n]


def match_with_spares(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    n: int,
    keypoints: Keypoints | None = None,
) -> list[Hypothesis]:
    """As :func:`match`, and some more for a caller who re-ranks them.

    Where keypoints are given, candidates come from them as well, people who lean are looked for,
    candidates count as they agree with the keypoints, and poses are interpolated and at last fitted
    to them.
    """
    return match_with_features(index, silhouette, n, keypoints)[0]


def match_with_features(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    n: int,
    keypoints: Keypoints | None = None,
) -> tuple[list[Hypothesis], NDArray[np.float64]]:
    """As :func:`match_with_spares`, with the features ``(N, F)`` behind the confidences."""
    if keypoints is None:
        leanings = [Leaning.of(silhouette, 0.0)]
        candidates, modes = _modes_by_silhouette(index, leanings, n)
    else:
        leanings, candidates, modes = _modes_by_both(index, silhouette, keypoints, n)
    modes = modes.nearest()
    numbers, mirrored = candidates.numbers[modes.centres], candidates.mirrored[modes.centres]
    lean_deg = candidates.lean_deg[modes.centres]
    others = index.silhouettes(numbers)
    others[mirrored] = others[mirrored, :, ::-1]
    errors = _outline_errors(leanings, others, lean_deg)
    features = match_features(candidates, modes, errors)
    confidences = Calibration.restore(index.parameters["confidence"]).probability(features)
    points_3d, points_normalised = modes.points_3d, modes.points_normalised
    log_likelihood = side_odds = np.zeros(len(modes))
    if keypoints is not None:
        # Poses that must change far to fit are less likely: they are judged as they were found.
        agreement = keypoints.compare(points_normalised)
        log_likelihood, side_odds = agreement.log_likelihood, agreement.side_odds
        points_3d, points_normalised = fit_to_keypoints(keypoints, points_3d, points_normalised)
    columns = (
        numbers, mirrored, modes.distances, errors, confidences, lean_deg, log_likelihood, side_odds
    )  # fmt: skip
    hypotheses = [
        Hypothesis(
            entry=entry,
            mirrored=is_mirrored,
            distance=distance,
            reprojection_error_px=error,
            confidence=confidence,
            points_3d=points_3d[row],
            points_normalised=points_normalised[row],
            lean_deg=lean,
            log_likelihood=likelihood,
            side_odds=odds,
        )
        for row, (entry, is_mirrored, distance, error, confidence, lean, likelihood, odds) in (
            enumerate(zip(*(column.tolist() for column in columns), strict=True))
        )
    ]
    return hypotheses, features


def _modes_by_silhouette(
    index: PoseIndex, leanings: Sequence[Leaning], n: int
) -> tuple[Candidates, Modes]:
    """Look at more candidates until they hold ``n`` modes or the index has no more."""
    k, most = max(CANDIDATES, 20 * n), 16 * CANDIDATES
    while True:
        candidates = find_leaning_candidates(index, leanings, k)
        modes = find_modes(candidates, n + SPARE_MODES)
        if len(modes) >= n or len(candidates) < k or k >= most:
            return candidates, modes
        k *= 2


def _modes_by_both(
    index: PoseIndex, silhouette: NDArray[np.uint8], keypoints: Keypoints, n: int
) -> tuple[list[Leaning], Candidates, Modes]:
    """As :func:`_modes_by_silhouette`, of candidates near the silhouette or the keypoints."""
    more = max(1, -(-20 * n // BY_SILHOUETTE))
    nearest = index.keypoint_search.nearest(keypoints, more * BY_KEYPOINTS)
    leanings = [Leaning.of(silhouette, lean) for lean in likely_leans(nearest.roll_deg)]
    while True:
        by_silhouette = find_leaning_candidates(index, leanings, more * BY_SILHOUETTE)
        by_keypoints = leaning_candidates_of(index, leanings, nearest)
        candidates = Candidates.merged([by_silhouette, by_keypoints]).unique()
        agreement = keypoints.compare(candidates.points_normalised)
        weights = mode_weights(candidates.distances, agreement)
        # The best, in ascending distance, as they came.
        best = np.sort(np.argsort(-weights, kind="stable")[: more * KEPT])
        candidates, agreement = candidates.take(best), agreement.take(best)
        modes = find_modes(candidates, n + SPARE_MODES_SEEN, agreement=agreement)
        if len(modes) >= n or len(candidates) < more * KEPT or more >= 16:
            return leanings, candidates, modes
        more *= 2


def match_features(
    candidates: Candidates, modes: Modes, errors: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Compute what :data:`index.confidence.FEATURES` names, for each mode ``(M, F)``."""
    distances, votes = np.log(modes.distances + 1e-6), np.log(modes.votes + 1e-6)
    nearest = np.full(len(modes), np.log(candidates.distances[0] + 1e-6))
    return np.stack(
        [
            distances,
            distances - distances.min(),
            votes,
            votes - votes.max(),
            nearest,
            np.asarray(errors, np.float64),
            np.log(np.arange(1, len(modes) + 1)),
            *np.log(_agreements(candidates, modes) + 1e-3),
        ],
        axis=-1,
    )


def _agreements(candidates: Candidates, modes: Modes) -> NDArray[np.float64]:
    """Shares ``(4, M)`` of the candidates that lie near each mode in the normalised frame.

    Which of several hypotheses is right shows less in how well each fits than in how many of
    the candidates would count as right if it is.
    """
    ours = modes.points_normalised[:, :JOINTS].astype(np.float32)
    # Candidates last: NumPy is several times as slow on short rows.
    theirs = candidates.points_normalised[:, :JOINTS].astype(np.float32).transpose(2, 1, 0).copy()
    squares = (ours[:, :, 0, None] - theirs[0]) ** 2
    squares += (ours[:, :, 1, None] - theirs[1]) ** 2
    errors = np.sqrt(squares).sum(axis=1) / np.float32(JOINTS)
    near = [(errors < px).astype(np.float64) for px in AGREEMENT_PX]
    weights = [candidate_weights(candidates.distances, f) for f in AGREEMENT_FALL_OFFS]
    return np.stack([n @ w / w.sum() for w in weights for n in near])


def _outline_errors(
    leanings: Sequence[Leaning], others: NDArray[np.uint8], lean_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances ``(B,)`` of the query's outline, set upright, from entries that lean."""
    errors = np.empty(len(others))
    for leaning in leanings:
        some = lean_deg == leaning.lean_deg
        if some.any():
            errors[some] = outline_distances(leaning.upright, others[some])
    return errors


def outline_distances(
    silhouette: NDArray[np.uint8], others: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """Mean distance between two outlines, both ways, in pixels.

    Parameters
    ----------
    silhouette : (128, 48) uint8 array
    others : (B, 128, 48) uint8 array

    Returns
    -------
    (B,) float64 array
    """
    every = np.concatenate([silhouette[None], others])
    # What lies outside of all of them is not asked for, and no way between two pixels leads there.
    left, top, width, height = cv2.boundingRect(every.max(axis=0))
    outlines = _outlines(every[:, top : top + max(1, height), left : left + max(1, width)])
    fields = _distance_fields(outlines).reshape(len(outlines), -1)
    on = outlines.reshape(len(outlines), -1).astype(np.float32)
    lengths = np.maximum(on.sum(axis=1), 1)
    there = on[1:] @ fields[0] / lengths[1:]
    back = fields[1:] @ on[0] / lengths[0]
    return np.asarray((there + back) / 2, np.float64)


def _outlines(silhouettes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Outermost pixels of silhouettes ``(B, H, W)``, all eroded at once."""
    count, height, width = silhouettes.shape
    # Background below each keeps them apart.
    apart = np.zeros((count, height + 1, width), np.uint8)
    apart[:, :height] = silhouettes != 0
    eroded = cv2.erode(
        apart.reshape(-1, width),
        np.ones((3, 3), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).reshape(apart.shape)
    return np.asarray((apart != eroded)[:, :height])


def _distance_fields(outlines: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distances ``(B, H, W)`` of all pixels from outlines; beyond all of them where is none."""
    fields = np.empty(outlines.shape, np.float32)
    for away, field in zip((~outlines).view(np.uint8), fields, strict=True):
        cv2.distanceTransform(away, cv2.DIST_L2, 3, field)
    fields[~outlines.any(axis=(1, 2))] = np.hypot(HEIGHT, WIDTH)
    return fields
