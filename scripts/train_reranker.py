"""Train the network that re-ranks an index's hypotheses: ``make reranker``.

    python -m scripts.train_reranker --mocap ../shared/mocap --garments ../shared/garments

It is written into the folder of the index, whose own files stay as they are. The clips that
``scripts.evaluate simulation`` asks for are kept from it, so that the experiment measures the
network that ships. About an hour on one core.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from index.artefact import load_index
from index.build.builder import IndexSpec
from index.build.garments import GarmentError
from index.build.joint_training import TrainingConfig
from index.build.motion import MotionError, read_manifest
from index.build.reranker import train_reranker
from index.build.splits import hold_out
from index.reranker import save_reranker
from index.store import DEFAULT_PATH


def main() -> int:
    """Parse the command line, train, save; 1 with one sentence where that fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--mocap", type=Path, default=Path("../shared/mocap"), help="what the index was built from")
    add("--garments", type=Path, help="MakeHuman garments; without them bodies are unclothed")
    add("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    add("--passes", type=float, default=TrainingConfig.passes, help="over the silhouettes")
    add("--seed", type=int, default=TrainingConfig.seed)
    arguments = parser.parse_args()
    try:
        kept, _ = hold_out(read_manifest(arguments.mocap))
        reranker = train_reranker(
            load_index(arguments.index, reranked=False),
            IndexSpec("", arguments.mocap, arguments.garments, segments=tuple(kept)),
            TrainingConfig(passes=arguments.passes, seed=arguments.seed),
            progress=True,
            log=lambda line: print(line, flush=True),
        )
        save_reranker(reranker, arguments.index)
    except (MotionError, GarmentError, ValueError, OSError) as error:
        print(f"train_reranker: {error}", file=sys.stderr)
        return 1
    print(f"Written to {arguments.index}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
