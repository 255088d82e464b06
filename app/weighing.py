"""Weighing hypotheses by what the photograph shows: which way a person faces, and joints.

A silhouette cannot tell front from back, nor what lies within it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.facing import Facing, azimuth_deg, faces_camera, front_share
from app.vision.facing_evidence import AzimuthBelief
from index.matching import Hypothesis

# Where a hypothesis is wrong, how likely none of the others is right either.
_UNTHOUGHT = 0.5

DISTANCE, FACING, JOINTS, SIDES = 4.0, 2.0, 1.0, 0.2
"""What the logarithms count: of the descriptors' distance, against a hypothesis, and of the
likelihoods of facing, joints and sides. Chosen on the street people of even-numbered
photographs."""

LEAN_DEG = 60.0
"""Few people lean: so much of it makes a hypothesis 1/e as likely."""

SLOPE, BIAS = 0.265, 3.404
"""From the sum of these to the log odds that a hypothesis is right; ``scripts.evaluate real
--fit-confidence`` prints them."""


@dataclass(frozen=True)
class Weighed:
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
        Those that all evidence gives.
    """

    facing: Facing
    hypotheses: tuple[Hypothesis, ...]
    distances: tuple[float, ...]
    confidences: tuple[float, ...]


def weigh(hypotheses: Sequence[Hypothesis], n: int) -> Weighed:
    """Leave the nearest ``n`` hypotheses as the silhouette alone gives them.

    Facing is the share of them, weighted by confidence, whose front faces the camera.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one, nearest first.
    n : int
    """
    hypotheses = tuple(hypotheses[:n])
    distances, confidences = zip(
        *((one.distance, one.confidence) for one in hypotheses), strict=True
    )
    facing = Facing(front_share(_azimuths(hypotheses), np.array(confidences)), "none")
    return Weighed(facing, hypotheses, distances, confidences)


def weigh_by_image(
    hypotheses: Sequence[Hypothesis], belief: AzimuthBelief | None, n: int
) -> Weighed:
    """Reorder hypotheses by what the photograph shows, and keep the nearest ``n``.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one; more than ``n`` leave more to choose from.
    belief : AzimuthBelief or None
        What the photograph tells of the azimuth, if anything.
    n : int
    """
    azimuths = _azimuths(hypotheses)
    likelihoods = np.ones(len(hypotheses)) if belief is None else belief.likelihood(azimuths)
    distances = distances_from_all(hypotheses, likelihoods)
    if any(one.log_likelihood for one in hypotheses):
        confidences = with_joints(distances)
    else:
        confidences = posterior(np.array([one.confidence for one in hypotheses]), likelihoods)
    chosen = nearest_with_twins(azimuths, distances, n)
    return Weighed(
        Facing(front_share(azimuths, confidences), "image"),
        tuple(hypotheses[i] for i in chosen),
        tuple(distances[chosen].tolist()),
        tuple(confidences[chosen].tolist()),
    )


def distances_from_all(
    hypotheses: Sequence[Hypothesis], likelihoods: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far hypotheses are ``(N,)`` from silhouette, facing and joints together.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
    likelihoods : (N,) float64 array
        Of what is seen of the facing, given each one's azimuth; 1 where nothing is.
    """
    evidence = (
        FACING * np.log(likelihoods)
        + JOINTS * np.array([one.log_likelihood for one in hypotheses])
        + SIDES * np.array([one.side_odds for one in hypotheses])
        - np.abs([one.lean_deg for one in hypotheses]) / LEAN_DEG
    )
    return np.array([one.distance for one in hypotheses]) * np.exp(-evidence / DISTANCE)


def with_joints(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Confidences ``(N,)`` where joints were read, of distances from all that is known."""
    agreement = -DISTANCE * np.log(np.maximum(distances, 1e-9))
    return np.asarray(1 / (1 + np.exp(-SLOPE * agreement - BIAS)))


def posterior(
    confidences: NDArray[np.float64], likelihoods: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Confidences after a look at the photograph, by Bayes' rule.

    Where a hypothesis is wrong, the truth is one of the others, or a pose unthought of, of any
    azimuth.

    Parameters
    ----------
    confidences : (N,) float64 array
        Probabilities that each hypothesis is right; several may be.
    likelihoods : (N,) float64 array
        Of what is seen, given each one; 1 where it tells nothing.

    Returns
    -------
    (N,) float64 array
        0 to 1.
    """
    before = np.clip(confidences, 1e-6, 1 - 1e-6)
    others = before.sum() - before
    elsewhere = (before @ likelihoods - before * likelihoods + 1e-9) / (others + 1e-9)
    right = before * likelihoods
    wrong = (1 - before) * ((1 - _UNTHOUGHT) * elsewhere + _UNTHOUGHT)
    return np.asarray(right / (right + wrong))


def nearest_with_twins(
    azimuths_deg: NDArray[np.float64], distances: NDArray[np.float64], n: int
) -> list[int]:
    """Choose ``n`` hypotheses, nearest first, a third of which face the other way.

    The photograph may mislead: the nearest of those that do not face as the first one does take
    the last places where fewer would be among them.

    Parameters
    ----------
    azimuths_deg, distances : (N,) float64 array
    n : int
    """
    order: list[int] = np.argsort(distances, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    twins = [i for i in order if front[i] != front[order[0]]]
    if n == 1 or not twins:
        return order[:n]
    kept = set(twins[: max(1, n // 3)])
    alike = [i for i in order if i not in kept][: n - len(kept)]
    return [i for i in order if i in kept.union(alike)]


def _azimuths(hypotheses: Sequence[Hypothesis]) -> NDArray[np.float64]:
    return azimuth_deg(np.array([one.points_3d for one in hypotheses]))
