"""What a step adds is measured against an index whose descriptors find random entries."""

import numpy as np
from numpy.testing import assert_array_equal

from index.store import PoseIndex
from scripts.experiments.stages import permuted


def test_in_a_permuted_index_a_descriptor_finds_another_entry(tiny_index: PoseIndex) -> None:
    other = permuted(tiny_index, 0)
    there, moved = tiny_index.vectors[slice(None)], other.vectors[slice(None)]
    assert_array_equal(np.sort(there, axis=0), np.sort(moved, axis=0))
    assert_array_equal(other.entries, tiny_index.entries)
    found = other.neighbours.search(there, 1)[1][:, 0]
    assert (found == np.arange(len(there))).mean() < 0.1
