"""Permuting the descriptors of the shipped index at random costs the default answer.

The people are silhouettes and skeletons of the index itself, simulated from clips that are then
left out of it, with the errors of landmarks drawn at random.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.photograph import Estimator
from index.landmark_matching import match_landmarks
from index.landmarks import NormalisedLandmarks
from index.search import ExactNeighbours
from index.skeleton import LIMB_HIPS, LIMB_ROWS
from index.store import PoseIndex
from scripts.experiments.permutation import permuted

PEOPLE = 30
EVERY_CLIP = 10
"""One clip in so many is held out."""

PICTURE_SD_PX, DEPTH_SD_M = 3.0, 0.15
"""Errors of the landmarks in the picture and in depth."""

LEAST_COST_MM = 4.0


def without(index: PoseIndex, held_out: NDArray[np.bool_]) -> PoseIndex:
    """A fifth of the index, to be fast, without some of its entries ``(E,)``."""
    kept = np.flatnonzero(~held_out)[::5]
    return replace(
        index,
        vectors=ExactNeighbours(index.vectors[kept]),
        entries=index.entries[kept],
        silhouette_store=index.silhouette_store.select(kept),
        searched_by=None,
    )


def about_hips(limbs: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(limbs - limbs[LIMB_HIPS].mean(axis=0))


def first_mm(index: PoseIndex, whole: PoseIndex, entries: NDArray[np.int64]) -> float:
    """Mean error of the first hypothesis of people who are entries of the whole index."""
    errors = []
    for number in entries.tolist():
        rng = np.random.default_rng(number)
        person = whole.entry(number)
        true = about_hips(person.points_3d[LIMB_ROWS])
        read = true + rng.normal(size=true.shape) * (0.02, 0.02, DEPTH_SD_M)
        placed = person.points_normalised[LIMB_ROWS]
        landmarks = NormalisedLandmarks(
            tuple(LIMB_ROWS),
            placed + rng.normal(0, PICTURE_SD_PX, placed.shape),
            np.full(12, 0.9),
            about_hips(read),
            np.full(12, 0.9),
            DEPTH_SD_M**2 * np.eye(12),
        )
        found = match_landmarks(index, whole.silhouette(number), 1, landmarks).hypotheses[0]
        apart = about_hips(found.points_3d[LIMB_ROWS]) - true
        errors.append(np.linalg.norm(apart, axis=-1).mean())
    return 1000 * float(np.mean(errors))


def test_permuted_descriptors_cost_the_default_answer(shipped: Estimator) -> None:
    index = shipped.index
    clips = index.skeleton_labels["clip"][index.entries["skeleton"]]
    held_out = clips % EVERY_CLIP == 0
    rest = without(index, held_out)
    people = np.random.default_rng(0).choice(np.flatnonzero(held_out), PEOPLE, replace=False)
    kept, lost = (first_mm(one, index, people) for one in (rest, permuted(rest)))
    assert lost >= kept + LEAST_COST_MM, (kept, lost)
