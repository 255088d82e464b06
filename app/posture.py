"""A person's posture, as the hypotheses vote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from index.posture import Posture


@dataclass(frozen=True)
class VotedPosture:
    """The posture with most of the hypotheses' confidence, and its share of it."""

    label: Posture
    probability: float


def vote_posture(postures: Sequence[Posture], confidences: Sequence[float]) -> VotedPosture:
    """Let hypotheses vote, each with the weight of its confidence.

    Parameters
    ----------
    postures : sequence of str
        Of at least one hypothesis, the best first, which decides ties.
    confidences : sequence of float
    """
    weights: dict[Posture, float] = {}
    for posture, confidence in zip(postures, confidences, strict=True):
        weights[posture] = weights.get(posture, 0.0) + confidence
    label = max(weights, key=lambda posture: weights[posture])
    total = sum(weights.values())
    return VotedPosture(label, weights[label] / total if total else 1 / len(weights))
