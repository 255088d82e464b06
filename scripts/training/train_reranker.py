"""Train the network that re-ranks an index's hypotheses: ``make reranker``.

It is written into the folder of the index, whose own files stay as they are. The held-out clips are
kept from it, so that ``evaluate simulation`` measures the network that ships. Training takes about
an hour on one core.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from index import DEFAULT_PATH
from index.artefact import load_index
from index.build.builder import IndexSpec, hold_out
from index.build.motion import read_manifest
from index.build.reranker import TrainingConfig, train_reranker
from index.build.writer import save_reranker
from scripts.results import SHARED


def main(arguments: Sequence[str] | None = None) -> None:
    """Train as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--mocap", type=Path, default=SHARED / "mocap", help="what the index was built from")
    add("--garments", type=Path, help="MakeHuman garments; without them bodies are unclothed")
    add("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    add("--passes", type=float, default=TrainingConfig.passes, help="over the silhouettes")
    add("--seed", type=int, default=TrainingConfig.seed)
    options = parser.parse_args(arguments)
    kept, _ = hold_out(read_manifest(options.mocap))
    reranker = train_reranker(
        load_index(options.index, reranked=False),
        IndexSpec("", options.mocap, options.garments, segments=tuple(kept)),
        TrainingConfig(passes=options.passes, seed=options.seed),
    )
    save_reranker(reranker, options.index)
    print(f"Written to {options.index}")
