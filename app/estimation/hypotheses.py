"""The poses that fit a person: matched, re-ranked, and placed on the photograph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.estimation.estimates import ObservedPerson, Person, PlacedHypothesis
from app.estimation.normalised_person import NormalisedPerson
from app.estimation.posture import estimate_posture, vote_posture
from app.estimation.reranking import rank_by_keypoints, rank_by_silhouette
from index.matching import (
    FIRST_HYPOTHESES,
    Hypothesis,
    match,
)
from index.store import Label, PoseIndex

VOTERS = FIRST_HYPOTHESES
"""Hypotheses that vote for a posture, however many are asked for."""


def normalise_person(person: ObservedPerson) -> NormalisedPerson | None:
    """Normalise a person's silhouette; None where there is none."""
    if person.silhouette is None:
        return None
    return NormalisedPerson.of(person.silhouette, person.landmarks)


def fit_poses(
    index: PoseIndex,
    observed: ObservedPerson,
    normalised: NormalisedPerson | None,
    n: int,
) -> Person:
    """Find the ``n`` nearest distinct poses of a person.

    Parameters
    ----------
    index : PoseIndex
    observed : ObservedPerson
    normalised : NormalisedPerson or None
        The same person; None where there is no silhouette.
    n : int
    """
    if normalised is None:
        return Person(observed, None, None, ())
    keypoints = normalised.keypoints()
    found = match(
        index,
        normalised.silhouette,
        n,
        keypoints,
        roll_deg=normalised.roll_deg,
        whole=normalised.whole,
    )
    matched = found.hypotheses
    # Posture and facing do not depend on how many are asked for.
    most = max(n, VOTERS)
    ranked = (
        rank_by_silhouette(matched, most, VOTERS)
        if keypoints is None
        else rank_by_keypoints(matched, most, found.first_batch)
    )
    presence = 1.0 if observed.presence is None else observed.presence
    confidences = [presence * confidence for confidence in ranked.confidences]
    votes = vote_posture(
        [hypothesis.posture for hypothesis in ranked.hypotheses[:VOTERS]], confidences[:VOTERS]
    )
    points_2d = normalised.points_in_frame(
        np.array([hypothesis.points_normalised for hypothesis in ranked.hypotheses[:n]])
    )
    placed = [
        PlacedHypothesis(hypothesis, distance, confidence, _label(index, hypothesis), points)
        for hypothesis, distance, confidence, points in zip(
            ranked.hypotheses[:n], ranked.distances[:n], confidences[:n], points_2d, strict=True
        )
    ]
    posture = estimate_posture(votes, observed.landmarks, presence)
    return Person(observed, ranked.facing, posture, tuple(placed))


def _label(index: PoseIndex, hypothesis: Hypothesis) -> Label:
    label = index.label(hypothesis.entry, mirrored=hypothesis.mirrored)
    return replace(label, roll_deg=hypothesis.tilt_deg)
