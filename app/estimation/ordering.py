"""Hypotheses of a silhouette, re-ranked by the keypoints of the photograph.

A silhouette shows neither front or back nor what lies inside its outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.estimation.facing import Facing, azimuth_deg, faces_camera, front_share
from app.vision.models import fitted_constants
from app.vision.odds import sigmoid
from index.matching import Hypothesis
from index.ranking import DISTANCE_WEIGHT

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
        and longer by keypoints that contradict it; where hypotheses of a later batch are nearer,
        that of the farthest before them.
    confidences : tuple of float
        By silhouette and keypoints.
    """

    facing: Facing
    hypotheses: tuple[Hypothesis, ...]
    distances: tuple[float, ...]
    confidences: tuple[float, ...]


def rank_by_silhouette(
    hypotheses: Sequence[Hypothesis], n: int, voters: int | None = None
) -> Ranked:
    """Keep the nearest ``n`` hypotheses, unchanged.

    The facing is the share of their confidence that faces the camera.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one, nearest first.
    n : int
    voters : int, optional
        How many of the first tell the facing; by default all that are kept.
    """
    hypotheses = tuple(hypotheses[:n])
    confidences = np.array([hypothesis.confidence for hypothesis in hypotheses])
    return Ranked(
        Facing(front_share(_azimuths(hypotheses[:voters]), confidences[:voters]), "none"),
        hypotheses,
        tuple(np.maximum.accumulate([one.fused_distance for one in hypotheses]).tolist()),
        tuple(confidences.tolist()),
    )


def rank_by_keypoints(
    hypotheses: Sequence[Hypothesis], n: int, voters: int | None = None
) -> Ranked:
    """Re-rank hypotheses that were matched with keypoints, and keep the nearest ``n``.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one; with more than ``n`` there is a choice.
    n : int
    voters : int, optional
        How many of the first tell the facing; by default all.
    """
    azimuths = _azimuths(hypotheses)
    distances = np.array([hypothesis.fused_distance for hypothesis in hypotheses])
    adjusted_m = np.array([hypothesis.adjusted_m for hypothesis in hypotheses])
    confidences = fused_confidences(distances, adjusted_m)
    chosen = nearest_of_both_facings(azimuths, distances, n)
    return Ranked(
        Facing(front_share(azimuths[:voters], confidences[:voters]), "image"),
        tuple(hypotheses[i] for i in chosen),
        tuple(np.maximum.accumulate(distances[chosen]).tolist()),
        tuple(confidences[chosen].tolist()),
    )


def fused_confidences(
    distances: NDArray[np.float64], adjusted_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Probabilities ``(N,)`` that hypotheses are right; fitted.

    Parameters
    ----------
    distances : (N,) float64 array
        By silhouette and landmarks.
    adjusted_m : (N,) float64 array
        How far the hypotheses were moved from their entries.
    """
    constants = fitted_constants("confidence")
    agreement = -DISTANCE_WEIGHT * np.log(np.maximum(distances, 1e-9))
    odds = (
        constants["slope"] * agreement + constants["adjusted_m"] * adjusted_m + constants["offset"]
    )
    return sigmoid(odds)


def nearest_of_both_facings(
    azimuths_deg: NDArray[np.float64], distances: NDArray[np.float64], n: int
) -> list[int]:
    """Choose ``n`` hypotheses, nearest first, a few of which face the opposite way.

    The last of every :data:`PER_OPPOSITE_FACING` faces the opposite way to the first, however far
    it is, if none before it does. The first k of n are those chosen for k.

    Parameters
    ----------
    azimuths_deg, distances : (N,) float64 array
    n : int
    """
    order: list[int] = np.argsort(distances, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    chosen: list[int] = []
    while order and len(chosen) < n:
        opposite = [i for i in order if front[i] != front[chosen[0]]] if chosen else []
        wanted = (len(chosen) + 1) // PER_OPPOSITE_FACING
        have = sum(bool(front[i] != front[chosen[0]]) for i in chosen)
        following = opposite[0] if opposite and have < wanted else order[0]
        order.remove(following)
        chosen.append(following)
    return chosen


def _azimuths(hypotheses: Sequence[Hypothesis]) -> NDArray[np.float64]:
    return azimuth_deg(np.array([hypothesis.points_3d for hypothesis in hypotheses]))
