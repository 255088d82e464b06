"""Indexes of experiments: without held-out clips, or of some entries."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from index import DEFAULT_PATH
from index.artefact import load_index, load_reranker
from index.network import RankingModel
from index.search import ExactNeighbours
from index.store import PoseIndex
from scripts.index.builder import IndexSpec, build, hold_out
from scripts.index.motion import Segment, read_manifest
from scripts.index.writer import save_index


def strict_index(shared: Path, folder: Path | None) -> PoseIndex:
    """Return an index built as the shipped one is, without the held-out clips, and its network.

    The folder keeps the index from one run to the next.
    """
    kept, held = hold_out(read_manifest(shared / "mocap"))
    if folder is not None and folder.exists():
        index = load_index(folder)
    else:
        spec = IndexSpec("strict", shared / "mocap", shared / "garments", segments=tuple(kept))
        index = build(spec)
        if folder is not None:
            save_index(index, folder)
    return replace(index, reranker=shipped_reranker(held))


def shipped_reranker(held: Sequence[Segment]) -> RankingModel | None:
    """Return the network beside the default index; a ValueError if it knows a held-out clip."""
    reranker = load_reranker(DEFAULT_PATH)
    if reranker is not None:
        known = {segment.clip for segment in held}.intersection(reranker.training["clips"])
        if known:
            raise ValueError(
                f"the network beside {DEFAULT_PATH} was trained on held-out clips: "
                f"{', '.join(sorted(known))}"
            )
    return reranker


def part(index: PoseIndex, rows: NDArray[np.int64]) -> PoseIndex:
    """Some entries of an index, searched exactly."""
    return replace(
        index,
        vectors=ExactNeighbours(index.vectors[rows]),
        entries=index.entries[rows],
        silhouette_store=index.silhouette_store.select(rows),
        version="",
        searched_by=None,
    )
