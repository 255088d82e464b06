"""Write a copy of an index that is searched in another way; poses and vectors stay as they are.

python -m scripts.change_search index/data /srv/ivf --search ivf
python -m scripts.change_search /srv/ivf /srv/sharper --search ivf --set nprobe=128
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from index.approximate import METHODS, ApproximateNeighbours
from index.artefact import copy_index, load_index
from index.neighbours import ExactNeighbours, Neighbours

SEARCHES = ("flat", *METHODS)


def build_search(
    vectors: NDArray[np.floating], kind: str, parameters: Mapping[str, int] | None = None
) -> Neighbours:
    """Build one of :data:`SEARCHES` among vectors.

    Parameters
    ----------
    vectors : (E, D) float array
    kind : str
    parameters : mapping, optional
        Instead of those that suit the number of vectors.

    Raises
    ------
    ValueError, TypeError
        If the kind does not take these parameters.
    """
    if kind == "flat":
        if parameters:
            raise ValueError(f"expected no parameters of a flat search, got {dict(parameters)}")
        return ExactNeighbours(vectors)
    suited: Any = METHODS[kind].suited(len(vectors))
    return ApproximateNeighbours.build(vectors, replace(suited, **(parameters or {})))


def setting(text: str) -> tuple[str, int]:
    """Parse ``name=number``."""
    name, _, value = text.partition("=")
    return name, int(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, load, save; 1 with one sentence where that fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("source", type=Path, help="folder of the artefact")
    add("out", type=Path, help="folder of the copy")
    add("--search", choices=SEARCHES, required=True)
    add("--set", type=setting, action="append", default=[], metavar="NAME=NUMBER",
        help="nlist, nprobe of ivf; m, ef_construction, ef_search of hnsw")  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        index = load_index(options.source)
        neighbours = build_search(index.vectors, options.search, dict(options.set))
        version = copy_index(options.source, options.out, neighbours)
    except (ValueError, TypeError, OSError) as error:
        print(f"change_search: {error}", file=sys.stderr)
        return 1
    print(f"{len(index)} entries in {options.out}, {options.search}, {version}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
