"""Hypotheses of a silhouette, re-ranked by the keypoints of the photograph.

A silhouette shows neither front or back nor what lies inside its outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.estimates import PlacedHypothesis
from app.facing import Facing, azimuth_deg, faces_camera, front_share
from app.vision.weights import fitted
from index.matching import Hypothesis

DISTANCE_WEIGHT, KEYPOINT_WEIGHT, SIDE_WEIGHT = 4.0, 1.0, 0.3
"""Weights of the log distance of the descriptors (against a hypothesis), of the keypoints' log
likelihood and of the log odds of their sides. Chosen on the street people of even-numbered
photographs."""

LEAN_SCALE_DEG = 60.0
"""Few people lean: a lean of this size makes a hypothesis 1/e as likely."""

PER_OPPOSITE_FACING = 7
"""Of every seven hypotheses, one faces the opposite way to the first: keypoints may mislead."""


@dataclass(frozen=True)
class Ranked:
    """Hypotheses, nearest first, and the facing.

    Parameters
    ----------
    facing : Facing
    hypotheses : tuple of Hypothesis
        Unchanged: their own distances and confidences are those of the silhouette.
    distances : tuple of float
        Ascending. The descriptors' distance, made shorter by keypoints that support a hypothesis
        and longer by keypoints that contradict it.
    confidences : tuple of float
        By silhouette and keypoints.
    """

    facing: Facing
    hypotheses: tuple[Hypothesis, ...]
    distances: tuple[float, ...]
    confidences: tuple[float, ...]


def rank_by_silhouette(hypotheses: Sequence[Hypothesis], n: int) -> Ranked:
    """Keep the nearest ``n`` hypotheses, unchanged.

    The facing is the share of their confidence that faces the camera.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one, nearest first.
    n : int
    """
    hypotheses = tuple(hypotheses[:n])
    confidences = np.array([hypothesis.confidence for hypothesis in hypotheses])
    return Ranked(
        Facing(front_share(_azimuths(hypotheses), confidences), "none"),
        hypotheses,
        tuple(hypothesis.distance for hypothesis in hypotheses),
        tuple(confidences.tolist()),
    )


def rank_by_keypoints(hypotheses: Sequence[Hypothesis], n: int) -> Ranked:
    """Re-rank hypotheses that were matched with keypoints, and keep the nearest ``n``.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one; with more than ``n`` there is a choice.
    n : int
    """
    azimuths = _azimuths(hypotheses)
    distances = fused_distances(hypotheses)
    confidences = fused_confidences(distances)
    chosen = nearest_of_both_facings(azimuths, distances, n)
    return Ranked(
        Facing(front_share(azimuths, confidences), "image"),
        tuple(hypotheses[i] for i in chosen),
        tuple(distances[chosen].tolist()),
        tuple(confidences[chosen].tolist()),
    )


def fused_distances(hypotheses: Sequence[Hypothesis]) -> NDArray[np.float64]:
    """Distances ``(N,)`` of hypotheses from silhouette and keypoints together."""
    likelihood = (
        KEYPOINT_WEIGHT * np.array([hypothesis.log_likelihood for hypothesis in hypotheses])
        + SIDE_WEIGHT * np.array([hypothesis.side_odds for hypothesis in hypotheses])
        - np.abs([hypothesis.tilt_deg for hypothesis in hypotheses]) / LEAN_SCALE_DEG
    )
    return np.array([hypothesis.distance for hypothesis in hypotheses]) * np.exp(
        -likelihood / DISTANCE_WEIGHT
    )


def fused_confidences(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities ``(N,)`` that hypotheses at fused distances are right; fitted."""
    constants = fitted("confidence")
    agreement = -DISTANCE_WEIGHT * np.log(np.maximum(distances, 1e-9))
    odds = constants["slope"] * agreement + constants["offset"]
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def nearest_of_both_facings(
    azimuths_deg: NDArray[np.float64], distances: NDArray[np.float64], n: int
) -> list[int]:
    """Choose ``n`` hypotheses, nearest first, a few of which face the opposite way.

    The nearest of those that face the opposite way to the first are among them however far they
    are; see :data:`PER_OPPOSITE_FACING`.

    Parameters
    ----------
    azimuths_deg, distances : (N,) float64 array
    n : int
    """
    order: list[int] = np.argsort(distances, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    others = [i for i in order if front[i] != front[order[0]]]
    if n == 1 or not others:
        return order[:n]
    kept = set(others[: max(1, n // PER_OPPOSITE_FACING)])
    alike = [i for i in order if i not in kept][: n - len(kept)]
    return [i for i in order if i in kept.union(alike)]


def keep_nearest(hypotheses: Sequence[PlacedHypothesis], n: int) -> tuple[PlacedHypothesis, ...]:
    """The nearest ``n``, a few of which face the opposite way; see :func:`nearest_of_both_facings`.

    Parameters
    ----------
    hypotheses : sequence of PlacedHypothesis
        Nearest first.
    n : int
    """
    if not hypotheses:
        return ()
    azimuths = _azimuths([placed.hypothesis for placed in hypotheses])
    distances = np.array([placed.distance for placed in hypotheses])
    return tuple(hypotheses[i] for i in nearest_of_both_facings(azimuths, distances, n))


def _azimuths(hypotheses: Sequence[Hypothesis]) -> NDArray[np.float64]:
    return azimuth_deg(np.array([hypothesis.points_3d for hypothesis in hypotheses]))
