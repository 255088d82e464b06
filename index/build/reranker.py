"""Training what re-ranks the hypotheses of an index, and fitting its confidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from index.build.builder import NOT_HELD_OUT, Asked, Plan, entries_of, simulate_queries, split
from index.build.calibrate import (
    Queries,
    expected_calibration_error,
    fit_calibration,
    run_trial,
)
from index.build.garments import CALIBRATION_AVATARS, make_avatars
from index.build.joint_training import Course, in_whole_numbers, train
from index.build.motion import Segment
from index.network import JointNetwork, network_input
from index.reranker import RERANKING_FEATURES, RankingModel
from index.store import PoseIndex

SHOWN = 400
"""Silhouettes that show how large values become within the network."""

FINISH = 0.2
"""Passes over all silhouettes, as a share of those without the clips kept for the confidence."""


def train_reranker(
    index: PoseIndex,
    motion: Path,
    garments: Path | None,
    segments: Sequence[Segment],
    course: Course,
    *,
    asked: Asked = Plan.calibration,
    progress: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> RankingModel:
    """Train the network on an index's silhouettes and fit the confidence of what it re-ranks.

    Some clips are kept from the network at first; the confidence is fitted on what the index,
    without their entries, answers to silhouettes of these clips on bodies of their own. Then the
    network learns from them as well, as the index has their entries.

    Parameters
    ----------
    index : PoseIndex
    motion : Path
        Folder with ``manifest.csv`` and ``bvh/``.
    garments : Path or None
        Folder of MakeHuman garments; without it the bodies that are asked for stay unclothed.
    segments : sequence of Segment
        Those that may be used: an experiment leaves out what it asks for.
    course : Course
    asked : Asked
        How many silhouettes the confidence is fitted on.
    progress : bool
        Whether to draw progress bars.
    say : callable
        Takes a line about the progress.

    Returns
    -------
    RankingModel
    """
    kept, held, honest = split(segments)
    if not honest:
        say(NOT_HELD_OUT)
    rows = entries_of(index, kept)
    if not len(rows):
        raise ValueError("expected an index with entries of the given motion, got none")
    say(f"Training on {len(rows):,} of {len(index):,} silhouettes of {index.name}.")
    layers = train(index, rows, course, say=say)
    network = _whole(layers, index, rows)
    simulated = simulate_queries(
        motion, held, make_avatars(CALIBRATION_AVATARS, garments), asked, course.seed + 1
    )
    queries = Queries.of(simulated).half_degraded(course.seed + 1)
    reranker = calibrated(part(index, rows), network, queries, progress=progress, say=say)
    everything = entries_of(index, segments)
    say(f"Going on with {len(everything):,} silhouettes.")
    finish = replace(course, passes=FINISH * course.passes, rate=course.rate / 2)
    layers = train(index, everything, finish, start=layers, say=say)
    training: dict[str, Any] = {
        "index": index.version,
        "entries": len(everything),
        "clips": sorted({segment.clip for segment in segments}),
        "passes": course.passes,
        "seed": course.seed,
        "confidence_fitted_on": len(queries),
        "of_clips_held_out": honest,
    }
    return replace(reranker, network=_whole(layers, index, everything), training=training)


def _whole(layers: nn.Sequential, index: PoseIndex, rows: NDArray[np.int64]) -> JointNetwork:
    """What was trained, in whole numbers whose steps some of the entries show."""
    some = rows[:: max(1, len(rows) // SHOWN)]
    return in_whole_numbers(layers, network_input(index.silhouettes(some)))


def calibrated(
    index: PoseIndex,
    network: JointNetwork,
    queries: Queries,
    *,
    progress: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> RankingModel:
    """Fit the confidence of what a network re-ranks, as the index builder does without one."""
    trial = run_trial(replace(index, reranker=RankingModel.of(network)), queries, progress=progress)
    calibration = fit_calibration(trial, RERANKING_FEATURES)
    confidence = calibration.probability(trial.features.reshape(-1, len(RERANKING_FEATURES)))
    say(
        f"Confidence fitted on {len(queries)} silhouettes that were held out, "
        "every second one degraded: "
        f"{100 * trial.right[:, 0].mean():.1f} % right at rank 1, "
        f"{100 * trial.right.any(axis=1).mean():.1f} % within 7, calibration error "
        f"{expected_calibration_error(confidence, trial.right):.3f}."
    )
    return RankingModel(network, calibration)


def part(index: PoseIndex, rows: NDArray[np.int64]) -> PoseIndex:
    """Some entries of an index, searched exactly."""
    return replace(
        index,
        vectors=index.vectors[rows],
        entries=index.entries[rows],
        silhouette_store=index.silhouette_store.select(rows),
        version="",
        searched_by=None,
    )
