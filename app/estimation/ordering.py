"""Which hypotheses of a match are returned, in which order, and which way the person faces.

The distances are those of :mod:`index.ranking`. Here, hypotheses of both facings are chosen, since
a silhouette shows neither front nor back. With landmarks, the confidences are computed here, too.
Afterwards, :mod:`app.estimation.estimator` multiplies the confidences by the probability that there
is a person.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.facing import Facing, azimuth_deg, faces_camera, front_share, heading_shares
from app.estimation.parameters import HYPOTHESES_PER_OPPOSITE_FACING
from app.vision.models import fitted_constants
from app.vision.odds import sigmoid
from index.matching import Hypothesis
from index.parameters import RANKING


def order_by_silhouette(
    hypotheses: Sequence[Hypothesis], n: int, voters: int | None = None
) -> tuple[Facing, list[Hypothesis]]:
    """Keep the first ``n`` hypotheses of a match without landmarks.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one, in the order of the match.
    voters : int, optional
        Number of hypotheses that decide the facing; by default all that are kept.

    Returns
    -------
    facing : Facing
        Its probability is the confidence of the hypotheses that face the camera, as a share of the
        confidence of all.
    hypotheses : list of Hypothesis
        In the order of the match, with ascending distances: a nearer hypothesis of a later batch
        gets the distance of the farthest one before it.
    """
    kept = hypotheses[:n]
    confidences = np.array([one.confidence for one in kept])
    facing = Facing(front_share(_azimuths(kept[:voters]), confidences[:voters]), "none")
    distances = np.array([one.distance for one in kept])
    return facing, _with(kept, distances, confidences)


def order_by_landmarks(
    hypotheses: Sequence[Hypothesis], n: int, voters: int | None = None
) -> tuple[Facing, list[Hypothesis]]:
    """Choose the nearest ``n`` hypotheses of a match with landmarks, some of either facing.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one; with more than ``n`` there is a choice.
    voters : int, optional
        Number of hypotheses that decide the facing; by default all.

    Returns
    -------
    facing, hypotheses
        As in :func:`order_by_silhouette`, with confidences from silhouette and landmarks.
    """
    azimuths = _azimuths(hypotheses)
    distances = np.array([one.distance for one in hypotheses])
    adjusted_m = np.array([one.adjusted_m for one in hypotheses])
    confidences = fused_confidences(distances, adjusted_m)
    front = front_share(azimuths[:voters], confidences[:voters])
    # A skeleton cannot be likelier right than its heading.
    shares = heading_shares(azimuths, azimuths[:voters], confidences[:voters])
    confidences = np.minimum(confidences, shares)
    chosen = nearest_of_both_facings(azimuths, distances, n, front)
    facing = Facing(front, "image")
    return facing, _with([hypotheses[i] for i in chosen], distances[chosen], confidences[chosen])


def fused_confidences(
    distances: NDArray[np.float64], adjusted_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fitted probabilities ``(N,)`` that hypotheses are right.

    Parameters
    ----------
    distances : (N,) float64 array
        Distances from silhouette and landmarks.
    adjusted_m : (N,) float64 array
        Mean joint distances by which the fit moved the hypotheses from their entries.
    """
    constants = fitted_constants("confidence")
    agreement = -RANKING.distance_weight * np.log(np.maximum(distances, 1e-9))
    odds = (
        constants["slope"] * agreement + constants["adjusted_m"] * adjusted_m + constants["offset"]
    )
    return sigmoid(odds)


def nearest_of_both_facings(
    azimuths_deg: NDArray[np.float64],
    distances: NDArray[np.float64],
    n: int,
    front_probability: float,
) -> list[int]:
    """Choose ``n`` hypotheses, nearest first, with each facing as frequent as it is likely.

    The nearest is first. Among the first k, the share that faces the opposite way equals the
    probability of that facing. It is at least one in
    :data:`app.estimation.parameters.HYPOTHESES_PER_OPPOSITE_FACING`, however far these hypotheses
    are, as long as there are any. The first k of n are those chosen for k.

    Parameters
    ----------
    azimuths_deg, distances : (N,) float64 array
    front_probability : float
        Probability that the camera sees the person from the front.

    Returns
    -------
    list of int
        Rows.
    """
    order: list[int] = np.argsort(distances, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    opposite_probability = 1 - front_probability if front[order[0]] else front_probability
    share = max(opposite_probability, 1 / HYPOTHESES_PER_OPPOSITE_FACING)
    chosen: list[int] = []
    while order and len(chosen) < n:
        opposite = [i for i in order if front[i] != front[chosen[0]]] if chosen else []
        wanted = int(share * (len(chosen) + 1) + 1e-9)  # Seven sevenths are one.
        have = sum(bool(front[i] != front[chosen[0]]) for i in chosen)
        following = opposite[0] if opposite and have < wanted else order[0]
        order.remove(following)
        chosen.append(following)
    return chosen


def _azimuths(hypotheses: Sequence[Hypothesis]) -> NDArray[np.float64]:
    return azimuth_deg(np.array([one.points_3d for one in hypotheses]))


def _with(
    hypotheses: Sequence[Hypothesis],
    distances: NDArray[np.float64],
    confidences: NDArray[np.float64],
) -> list[Hypothesis]:
    """Replace confidences, and distances by their running maxima."""
    ascending = np.maximum.accumulate(distances)
    return [
        replace(one, distance=distance, confidence=confidence)
        for one, distance, confidence in zip(
            hypotheses, ascending.tolist(), confidences.tolist(), strict=True
        )
    ]
