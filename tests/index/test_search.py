"""Exact search of descriptors and of limbs: the same as comparing with each vector."""

from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.search import (
    LANDMARK_DIMENSION,
    STEPS_PER_BODY,
    STEPS_PER_UNIT,
    ExactNeighbours,
    LandmarkSearch,
    body_sizes,
    mirrored_limbs,
    pose_vectors,
    scale_factor,
)
from index.skeleton import LIMB_HIPS, LIMB_ROWS, LIMBS, rotate_clockwise
from index.store import PoseIndex

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

    def test_values_beyond_a_byte_do_not_overflow(self, dimension: int, spread: float) -> None:
        ends = np.full((2, dimension), LARGEST, np.float32)
        ends[1] *= -1
        vectors = np.concatenate([in_steps(900, dimension, spread), ends])
        _, numbers = ExactNeighbours(vectors).search(ends * np.float32(1.3), 1)
        assert_array_equal(numbers[:, 0], [900, 901])


def test_other_vectors_are_compared_as_floats() -> None:
    rng = np.random.default_rng(0)
    vectors, queries = (rng.normal(0, 3, (n, 16)).astype(np.float32) for n in (400, 7))
    assert scale_factor(vectors) == 1
    squared, numbers = ExactNeighbours(vectors).search(queries, K)
    expected, order = nearest_by_hand(vectors, queries)
    assert_array_equal(numbers, order)
    assert_allclose(squared, expected, rtol=1e-4)


ROLLS = (0.0, 35.0, -120.0)
STEP = 1 / STEPS_PER_BODY
"""Coordinates are whole numbers of this share of a body's size."""


def some_limbs(seed: int, count: int = 1) -> NDArray[np.float64]:
    """Limbs ``(count, 12, 3)`` of people of about 1.7 m, anywhere."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 0.4, (count, 12, 3)) + rng.normal(0, 3, (count, 1, 3))


def upright_limbs(index: PoseIndex) -> NDArray[np.float64]:
    """Limbs ``(E, 12, 3)`` of all entries, as cameras that are not rolled see them."""
    points = index.points(np.arange(len(index)))[0][:, LIMB_ROWS]
    rolls = index.roll_deg(np.arange(len(index)), np.zeros(len(index), bool))
    return np.stack(
        [rotate_clockwise(one, -roll) for one, roll in zip(points, rolls.tolist(), strict=True)]
    )


def normalised(limbs: NDArray[np.float64]) -> NDArray[np.float64]:
    """About the hips, in sizes of the body, without rounding."""
    return (limbs - limbs[:, LIMB_HIPS].mean(axis=1, keepdims=True)) / body_sizes(limbs)[
        :, None, None
    ]


def limb_distances(
    limbs: NDArray[np.float64], limbs_3d: NDArray[np.float64], rolls_deg: tuple[float, ...]
) -> NDArray[np.float64]:
    """Root mean square joint distances ``(R, 2, E)``, straight and mirrored, one by one."""
    found = np.empty((len(rolls_deg), 2, len(limbs)))
    stored = normalised(limbs)
    for row, roll in enumerate(rolls_deg):
        unrolled = rotate_clockwise(limbs_3d, -roll)
        for column, variant in enumerate((unrolled, mirrored_limbs(unrolled))):
            offsets = stored - normalised(variant[None])
            found[row, column] = np.sqrt((offsets**2).sum(axis=-1).mean(axis=-1))
    return found


@pytest.mark.parametrize("number", [5, 130, 400])
@pytest.mark.parametrize("rolls_deg", [(0.0,), ROLLS])
def test_landmark_search_equals_comparing_with_each_entry(
    toy_index: PoseIndex, number: int, rolls_deg: tuple[float, ...]
) -> None:
    limbs = upright_limbs(toy_index)
    rng = np.random.default_rng(number)
    limbs_3d = 1.3 * rotate_clockwise(limbs[number] + rng.normal(0, 0.05, (12, 3)), 20) + (1, 2, 3)
    k = 40
    found = toy_index.landmark_search.nearest(limbs_3d, rolls_deg, k)
    expected = limb_distances(limbs, limbs_3d, rolls_deg)
    row = np.array([rolls_deg.index(roll) for roll in found.roll_deg.tolist()])
    own = expected[row, found.mirrored.astype(int), found.entry_ids]
    # Each coordinate is rounded to a step, in both.
    assert_allclose(own, np.sort(expected.ravel())[:k], atol=2 * STEP)


@given(seed=st.integers(0, 9999), scale=st.floats(0.1, 9), x=st.floats(-50, 50))
def test_place_and_size_of_a_person_do_not_matter(seed: int, scale: float, x: float) -> None:
    limbs = some_limbs(seed)
    assert_allclose(pose_vectors(scale * limbs + x), pose_vectors(limbs), atol=1)
    assert_allclose(body_sizes(scale * limbs + x), scale * body_sizes(limbs), rtol=1e-6)


@given(seed=st.integers(0, 9999))
def test_pose_vectors_fit_a_byte(seed: int) -> None:
    vectors = pose_vectors(some_limbs(seed, 5))
    assert vectors.shape == (5, LANDMARK_DIMENSION)
    assert (vectors == np.rint(vectors)).all() and np.abs(vectors).max() <= 127
    assert (vectors[:, 3 * len(LIMBS) :] == 0).all()
    assert pose_vectors(np.zeros((1, 12, 3))).tolist() == np.zeros((1, LANDMARK_DIMENSION)).tolist()


def test_finds_at_most_all_entries(toy_index: PoseIndex) -> None:
    limbs_3d = upright_limbs(toy_index)[7]
    search = toy_index.landmark_search
    found = search.nearest(limbs_3d, (0.0, 40.0), 10**6)
    assert len(search) == len(toy_index) == len(found.entry_ids)
    triples = zip(found.entry_ids.tolist(), found.mirrored.tolist(), found.roll_deg.tolist(),
                  strict=True)  # fmt: skip
    assert len(set(triples)) == len(found.entry_ids)
    fewer = search.nearest(limbs_3d, (0.0, 40.0), 20)
    assert_array_equal(fewer.entry_ids, found.entry_ids[:20])
    assert_array_equal(fewer.mirrored, found.mirrored[:20])


@pytest.mark.parametrize("shape", [(4, 36), (4, 12, 3)])
def test_vectors_of_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected vectors of shape \(E, 48\)"):
        LandmarkSearch(np.zeros(shape, np.float32))


def test_a_forked_process_can_search() -> None:
    """OpenMP's threads do not follow into it."""
    vectors = in_steps(20_000, LANDMARK_DIMENSION, 4.0)
    expected = ExactNeighbours(vectors).search(vectors[:1], 1)[1]
    LandmarkSearch(np.rint(vectors))
    asked: Any = get_context("fork").SimpleQueue()

    def child() -> None:
        LandmarkSearch(np.rint(vectors))
        asked.put(ExactNeighbours(vectors).search(vectors[:1], 1)[1])

    process = get_context("fork").Process(target=child)
    process.start()
    process.join(60)
    process.kill()
    assert process.exitcode == 0
    assert_array_equal(asked.get(), expected)
