"""Hypotheses of a silhouette, re-ranked by the keypoints of the photograph.

A silhouette cannot tell front from back, nor what lies within it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.facing import Facing, azimuth_deg, faces_camera, front_share
from app.vision.weights import fitted
from index.matching import Hypothesis

DISTANCE, KEYPOINTS, SIDES = 4.0, 1.0, 0.3
"""What the logarithms count: of the descriptors' distance, against a hypothesis, and of the
likelihoods of keypoints and of their sides. Chosen on the street people of even-numbered
photographs."""

LEAN_DEG = 60.0
"""Few people lean: so much of it makes a hypothesis 1/e as likely."""

OTHER_WAY = 7
"""One of so many hypotheses faces the other way than the first: the photograph may mislead."""


@dataclass(frozen=True)
class Ranked:
    """Hypotheses, nearest first, and the facing.

    Parameters
    ----------
    facing : Facing
    hypotheses : tuple of Hypothesis
        As they came: their own distances and confidences are those of the silhouette.
    distances : tuple of float
        Ascending: of each from all that is known. That is the descriptors' distance, and what
        the photograph shows for a hypothesis makes it shorter, what it shows against it longer.
    confidences : tuple of float
        Those that all of it gives.
    """

    facing: Facing
    hypotheses: tuple[Hypothesis, ...]
    distances: tuple[float, ...]
    confidences: tuple[float, ...]


def rank_by_silhouette(hypotheses: Sequence[Hypothesis], n: int) -> Ranked:
    """Leave the nearest ``n`` hypotheses as the silhouette alone gives them.

    Facing is the share of them, weighted by confidence, whose front faces the camera.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one, nearest first.
    n : int
    """
    hypotheses = tuple(hypotheses[:n])
    confidences = np.array([one.confidence for one in hypotheses])
    return Ranked(
        Facing(front_share(_azimuths(hypotheses), confidences), "none"),
        hypotheses,
        tuple(one.distance for one in hypotheses),
        tuple(confidences.tolist()),
    )


def rank_by_keypoints(hypotheses: Sequence[Hypothesis], n: int) -> Ranked:
    """Re-rank hypotheses that were matched with keypoints, and keep the nearest ``n``.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one; more than ``n`` leave more to choose from.
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
    """How far hypotheses are ``(N,)`` from silhouette and keypoints together."""
    likelihood = (
        KEYPOINTS * np.array([one.log_likelihood for one in hypotheses])
        + SIDES * np.array([one.side_odds for one in hypotheses])
        - np.abs([one.lean_deg for one in hypotheses]) / LEAN_DEG
    )
    return np.array([one.distance for one in hypotheses]) * np.exp(-likelihood / DISTANCE)


def fused_confidences(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities ``(N,)`` that hypotheses at fused distances are right; fitted."""
    constants = fitted("confidence")
    agreement = -DISTANCE * np.log(np.maximum(distances, 1e-9))
    odds = constants["slope"] * agreement + constants["offset"]
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def nearest_of_both_facings(
    azimuths_deg: NDArray[np.float64], distances: NDArray[np.float64], n: int
) -> list[int]:
    """Choose ``n`` hypotheses, nearest first, some of which face the other way.

    The nearest of those that do not face as the first one does take the last places where none
    would be among them; see :data:`OTHER_WAY`.

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
    kept = set(others[: max(1, n // OTHER_WAY)])
    alike = [i for i in order if i not in kept][: n - len(kept)]
    return [i for i in order if i in kept.union(alike)]


def _azimuths(hypotheses: Sequence[Hypothesis]) -> NDArray[np.float64]:
    return azimuth_deg(np.array([one.points_3d for one in hypotheses]))
