"""Exact search of descriptors: the same as comparing with each vector."""

from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.search import STEPS_PER_UNIT, ExactNeighbours, scale_factor

LARGEST = 127 / float(STEPS_PER_UNIT)
K = 20


def _rounded(values: NDArray[np.floating]) -> NDArray[np.float32]:
    steps = np.rint(values * STEPS_PER_UNIT) / STEPS_PER_UNIT
    return steps.clip(-LARGEST, LARGEST).astype(np.float32)


def in_steps(count: int, dimension: int, spread: float, seed: int = 0) -> NDArray[np.float32]:
    """Vectors whose values are multiples of a step and fit into a byte."""
    values = np.random.default_rng(seed).normal(0, spread, (count, dimension))
    return _rounded(values)


def nearest_by_hand(
    vectors: NDArray[np.float32], queries: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    squared = ((queries[:, None].astype(np.float64) - vectors) ** 2).sum(axis=-1)
    order = np.argsort(squared, axis=1, kind="stable")[:, :K]
    return np.take_along_axis(squared, order, axis=1), order


# FAISS has code of its own for multiples of 16.
@pytest.mark.parametrize("dimension", [12, 16, 48])
@pytest.mark.parametrize("spread", [0.5, 4.0, 12.0])
class TestBytes:
    def test_queries_in_steps_are_compared_exactly(self, dimension: int, spread: float) -> None:
        vectors, queries = (in_steps(n, dimension, spread, seed=n) for n in (900, 9))
        assert scale_factor(vectors) == STEPS_PER_UNIT
        squared, numbers = ExactNeighbours(vectors).search(queries, K)
        expected, _ = nearest_by_hand(vectors, queries)
        assert_array_equal(squared, expected)
        found = ((queries[:, None] - vectors[numbers]) ** 2).sum(axis=-1)
        assert_array_equal(found, squared)

    def test_other_queries_are_rounded_to_steps(self, dimension: int, spread: float) -> None:
        vectors = in_steps(900, dimension, spread)
        queries = np.random.default_rng(1).normal(0, spread, (9, dimension)).astype(np.float32)
        rounded = _rounded(queries)
        ours, theirs = (ExactNeighbours(vectors).search(q, K) for q in (queries, rounded))
        for one, other in zip(ours, theirs, strict=True):
            assert_array_equal(one, other)


def test_other_vectors_are_compared_as_floats() -> None:
    rng = np.random.default_rng(0)
    vectors, queries = (rng.normal(0, 3, (n, 16)).astype(np.float32) for n in (400, 7))
    assert scale_factor(vectors) == 1
    squared, numbers = ExactNeighbours(vectors).search(queries, K)
    expected, order = nearest_by_hand(vectors, queries)
    assert_array_equal(numbers, order)
    assert_allclose(squared, expected, rtol=1e-4)


def test_a_forked_process_can_search() -> None:
    """OpenMP's threads do not follow into it."""
    vectors = in_steps(20_000, 48, 4.0)
    expected = ExactNeighbours(vectors).search(vectors[:1], 1)[1]
    asked: Any = get_context("fork").SimpleQueue()

    def child() -> None:
        asked.put(ExactNeighbours(vectors).search(vectors[:1], 1)[1])

    process = get_context("fork").Process(target=child)
    process.start()
    process.join(60)
    process.kill()
    assert process.exitcode == 0
    assert_array_equal(asked.get(), expected)
