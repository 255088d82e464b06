"""Training the network that re-ranks the hypotheses of an index, and fitting its confidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from index.build.builder import IndexSpec, simulate_queries
from index.build.calibrate import Queries, calibrate
from index.build.garments import make_avatars
from index.build.joint_training import TrainingConfig, in_whole_numbers, train
from index.build.motion import read_manifest
from index.build.parameters import NETWORK
from index.build.splits import CALIBRATION_AVATARS, NOT_HELD_OUT, entries_of, split
from index.network import JointNetwork, network_input
from index.reranker import RERANKING_FEATURES, RankingModel
from index.store import PoseIndex


def train_reranker(
    index: PoseIndex,
    spec: IndexSpec,
    config: TrainingConfig,
    *,
    progress: bool = False,
    log: Callable[[str], None] = lambda _: None,
) -> RankingModel:
    """Train the network on an index's silhouettes and fit the confidence of what it re-ranks.

    At first the network does not see some clips; the confidence is fitted on what the index,
    without their entries, answers to silhouettes of these clips on bodies of their own. Then the
    network learns from them as well, as the index has their entries.

    Parameters
    ----------
    index : PoseIndex
    spec : IndexSpec
        What the index was built from. Its ``segments`` may be used: an experiment leaves out those
        that it asks for. The confidence is fitted on ``plan.calibration`` silhouettes.
    config : TrainingConfig
    progress : bool
        Whether to show progress bars.
    log : callable
        Takes sentences about the progress.

    Raises
    ------
    ValueError
        If the index has no entry of the segments.
    """
    segments = read_manifest(spec.motion) if spec.segments is None else spec.segments
    kept, held, by_clip = split(segments)
    if not by_clip:
        log(NOT_HELD_OUT)
    rows = entries_of(index, kept)
    if not len(rows):
        raise ValueError("expected an index with entries of the given motion, got none")
    log(f"Training on {len(rows):,} of {len(index):,} silhouettes of {index.name}.")
    layers = train(index, rows, config, log=log)
    network = _whole(layers, index, rows)
    simulated = simulate_queries(
        spec.motion,
        held,
        make_avatars(CALIBRATION_AVATARS, spec.garments),
        spec.plan.calibration,
        config.seed + 1,
    )
    queries = Queries.of(simulated).half_degraded(config.seed + 1)
    reranker = calibrated(part(index, rows), network, queries, progress=progress, log=log)
    everything = entries_of(index, segments)
    log(f"Going on with {len(everything):,} silhouettes.")
    finish = replace(config, passes=NETWORK.finishing_share * config.passes, rate=config.rate / 2)
    layers = train(index, everything, finish, start=layers, log=log)
    training: dict[str, Any] = {
        "index": index.version,
        "entries": len(everything),
        "clips": sorted({segment.clip for segment in segments}),
        "passes": config.passes,
        "seed": config.seed,
        "confidence_fitted_on": len(queries),
        "of_clips_held_out": by_clip,
    }
    return replace(reranker, network=_whole(layers, index, everything), training=training)


def _whole(layers: nn.Sequential, index: PoseIndex, rows: NDArray[np.int64]) -> JointNetwork:
    """The trained network in whole numbers, scaled to the values of some of the entries."""
    some = rows[:: max(1, len(rows) // NETWORK.scale_sample)]
    return in_whole_numbers(layers, network_input(index.silhouettes(some)))


def calibrated(
    index: PoseIndex,
    network: JointNetwork,
    queries: Queries,
    *,
    progress: bool = False,
    log: Callable[[str], None] = lambda _: None,
) -> RankingModel:
    """A network with the confidence that is fitted to its ranking of an index's answers."""
    asked = replace(index, reranker=RankingModel.of(network))
    calibration = calibrate(asked, queries, RERANKING_FEATURES, progress=progress, log=log)
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
