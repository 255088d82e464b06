"""Poses by keypoints alone: what they tell without the silhouette, to hold both together against.

The nearest entries by keypoints take the place of those by silhouette, all as if their silhouettes
fitted alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.estimates import ObservedPerson, Person, PlacedHypothesis, Scene
from app.estimator import Estimator
from app.posture import vote_posture
from app.reranking import rank_by_keypoints
from app.stopwatch import Stopwatch
from app.upright import UprightPerson
from app.vision.people import Box, Silhouette
from index.keypoint_fit import fit_to_keypoints
from index.matching import KEPT_CANDIDATES, SPARE_MODES_WITH_KEYPOINTS, Hypothesis
from index.modes import find_modes
from index.rotations import (
    RotatedQuery,
    compare_rotated_entries,
    likely_rotations,
    seen_from,
)
from index.store import PoseIndex


def estimate_by_keypoints(
    estimator: Estimator, frame: NDArray[np.uint8], box: Box, silhouette: Silhouette, n: int
) -> Person | None:
    """Hypotheses by the keypoints in a box; None where none are seen.

    The silhouette serves as the frame of reference alone.
    """
    scene = Scene(frame, (ObservedPerson(box, "boxes", None, silhouette),))
    (found,) = estimator.with_keypoints(scene, lambda: None, Stopwatch()).people
    upright = UprightPerson.of(silhouette, found.keypoints)
    matched = _match(estimator.index, upright, n)
    if matched is None:
        return None
    ranked = rank_by_keypoints(matched, n)
    points = upright.points_in_frame(np.array([one.points_normalised for one in ranked.hypotheses]))
    placed = [
        PlacedHypothesis(one, distance, confidence, estimator.index.label(one.entry), points_2d)
        for one, distance, confidence, points_2d in zip(
            ranked.hypotheses, ranked.distances, ranked.confidences, points, strict=True
        )
    ]
    posture = vote_posture(
        [hypothesis.posture for hypothesis in ranked.hypotheses], ranked.confidences
    )
    return Person(found, ranked.facing, posture, tuple(placed))


def _match(index: PoseIndex, upright: UprightPerson, n: int) -> list[Hypothesis] | None:
    keypoints = upright.keypoints()
    if keypoints is None:
        return None
    nearest = index.keypoint_search.nearest(keypoints.rotated(-upright.roll_deg), KEPT_CANDIDATES)
    nearest = seen_from(index, nearest, upright.roll_deg)
    rotations = likely_rotations(nearest.roll_deg)
    queries = [RotatedQuery.of(upright.normalised, rotation) for rotation in rotations]
    candidates = compare_rotated_entries(index, queries, nearest)
    candidates = replace(
        candidates,
        distances=np.ones(len(candidates)),
        offsets=np.zeros_like(candidates.offsets),
    )
    agreement = keypoints.compare(candidates.points_normalised)
    modes = find_modes(candidates, n + SPARE_MODES_WITH_KEYPOINTS, agreement=agreement)
    agreement = keypoints.compare(modes.points_normalised)
    points_3d, points_normalised = fit_to_keypoints(
        keypoints, modes.points_3d, modes.points_normalised
    )
    return [
        Hypothesis(
            entry=int(candidates.numbers[centre]),
            mirrored=bool(candidates.mirrored[centre]),
            distance=1.0,
            reprojection_error_px=0.0,
            confidence=0.5,
            points_3d=points_3d[row],
            points_normalised=points_normalised[row],
            rotation_deg=float(candidates.rotation_deg[centre]),
            log_likelihood=float(agreement.log_likelihood[row]),
            side_odds=float(agreement.side_odds[row]),
        )
        for row, centre in enumerate(modes.centres)
    ]
