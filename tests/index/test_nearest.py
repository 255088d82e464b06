"""The short list changes how fast the nearest are found, never which."""

from __future__ import annotations

import faiss
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from index.nearest import LEAST_LISTED, WORTHWHILE, NearestVectors

COUNT = 2 * WORTHWHILE * LEAST_LISTED


class CountedFlat(faiss.IndexFlatL2):  # type: ignore[misc, unused-ignore]
    """A flat index that counts how often it is asked."""

    asked = 0

    def search(self, *args: object) -> object:
        self.asked += 1
        return super().search(*args)


def flat_of(vectors: NDArray[np.float32]) -> CountedFlat:
    flat = CountedFlat(vectors.shape[1])
    flat.add(vectors)
    return flat


def gathered(dimension: int, *, seed: int = 0) -> NDArray[np.float32]:
    """Vectors about centres, as descriptors of one motion lie."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(0, 2, (COUNT // 50, dimension))
    return (centres.repeat(50, axis=0) + rng.normal(0, 1, (COUNT, dimension))).astype(np.float32)


@pytest.mark.parametrize("k", [1, 20, 200])
def test_finds_what_a_flat_index_finds(k: int) -> None:
    vectors = gathered(48)
    flat = flat_of(vectors)
    queries = vectors[::1000] + np.float32(0.5)
    squared, numbers = flat.search(queries, max(k, 2))
    found, found_numbers, _ = NearestVectors(flat).search(queries[:, None], k)
    assert_array_equal(found_numbers, numbers[:, :k])
    assert_array_equal(found, squared[:, :k])


@pytest.mark.parametrize("count", [30, COUNT])
@pytest.mark.parametrize("k", [1, 20, 50])
def test_finds_what_is_near_any_variant(count: int, k: int) -> None:
    vectors = gathered(48)[:count]
    flat = flat_of(vectors)
    queries = np.stack([vectors[: 40 * 15 : 40], -vectors[: 40 * 15 : 40]], axis=1)
    queries[:, 1, ::2] *= -1
    squared, numbers, variants = NearestVectors(flat).search(queries, k)
    each, each_numbers = flat.search(queries.reshape(-1, 48), min(k, count))
    for row in range(len(queries)):
        both = [
            (*pair, v)
            for v in (0, 1)
            for pair in zip(each[2 * row + v], each_numbers[2 * row + v], strict=True)
        ]
        expected = sorted(both, key=lambda one: (one[0], one[2], one[1]))[:k]
        found = list(zip(squared[row], numbers[row], variants[row], strict=True))
        assert found == expected


def test_usually_leaves_the_flat_index_alone() -> None:
    vectors = gathered(48)
    flat = flat_of(vectors)
    nearest = NearestVectors(flat)
    for query in vectors[::1000] + np.float32(0.5):
        nearest.search(query[None, None], 20)
    assert flat.asked <= 1


def test_names_the_first_of_equals_first() -> None:
    vectors = np.tile(gathered(48)[: COUNT // 4], (4, 1))
    queries = vectors[:3, None] + np.float32(0.1)
    _, numbers, _ = NearestVectors(flat_of(vectors)).search(queries, 8)
    assert_array_equal(numbers[:, :4], np.arange(3)[:, None] + np.arange(4) * (COUNT // 4))


def test_asks_the_flat_index_where_values_lie_off_the_grid() -> None:
    """So few values are far out that the grid ends before them, but the query is out there."""
    vectors = gathered(48)
    rng = np.random.default_rng(1)
    vectors[:: COUNT // 20, :] *= rng.uniform(20, 40, (20, 1)).astype(np.float32)
    flat = flat_of(vectors)
    queries = vectors[:: COUNT // 20] + np.float32(0.5)
    squared, numbers = flat.search(queries, 20)
    found, found_numbers, _ = NearestVectors(flat).search(queries[:, None], 20)
    assert flat.asked == 2
    assert_array_equal(found_numbers, numbers)
    assert_array_equal(found, squared)


@pytest.mark.parametrize(("count", "dimension"), [(50, 48), (COUNT, 7)])
def test_takes_few_vectors_and_odd_dimensions(count: int, dimension: int) -> None:
    vectors = gathered(dimension)[:count]
    flat = flat_of(vectors)
    squared, numbers = flat.search(vectors[:5], 10)
    found, found_numbers, _ = NearestVectors(flat).search(vectors[:5, None], 10)
    assert_array_equal(found_numbers, numbers)
    assert_array_equal(found, squared)
