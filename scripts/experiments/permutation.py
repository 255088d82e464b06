"""What the descriptor is worth: an index whose descriptors belong to random other entries."""

from dataclasses import replace

import numpy as np

from index.search import ExactNeighbours
from index.store import PoseIndex


def permuted(index: PoseIndex, seed: int = 0) -> PoseIndex:
    """Return the index with its descriptors permuted at random: a search finds random entries."""
    rows = np.random.default_rng(seed).permutation(len(index))
    return replace(index, vectors=ExactNeighbours(index.vectors[rows]), searched_by=None)
