"""A person's posture, as the hypotheses vote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from index.matching import Hypothesis
from index.posture import Posture


@dataclass(frozen=True)
class VotedPosture:
    """The posture with most of the hypotheses' confidence, and its share of it."""

    label: Posture
    probability: float


def vote_posture(hypotheses: Sequence[Hypothesis], confidences: Sequence[float]) -> VotedPosture:
    """Let hypotheses vote, each with the weight of its confidence.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        At least one, the best first, which decides ties.
    confidences : sequence of float
    """
    weights: dict[Posture, float] = {}
    for hypothesis, confidence in zip(hypotheses, confidences, strict=True):
        weights[hypothesis.posture] = weights.get(hypothesis.posture, 0.0) + confidence
    label = max(weights, key=lambda posture: weights[posture])
    total = sum(weights.values())
    return VotedPosture(label, weights[label] / total if total else 1 / len(weights))
