"""The index in memory: consistency of its parts, search, and entries."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from index.search import ExactNeighbours
from index.store import PoseIndex


class TestConstruction:
    @pytest.mark.parametrize(
        ("field", "value", "message"),
        [
            ("vectors", np.zeros((3, 48), np.float32), r"expected vectors of shape \(576, 48\)"),
            ("skeletons", np.zeros((1, 19, 3), np.float16), "expected skeletons of shape"),
            ("skeletons", np.zeros((1, 24, 3), np.float16), "expected skeletons of shape"),
        ],
    )  # fmt: skip
    def test_parts_must_fit(
        self, toy_index: PoseIndex, field: str, value: object, message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(toy_index, **{field: value})

    def test_empty_index_is_refused(self, toy_index: PoseIndex) -> None:
        with pytest.raises(ValueError, match="at least one entry"):
            dataclasses.replace(toy_index, entries=toy_index.entries[:0])


class TestSearch:
    @pytest.mark.parametrize("k", [1, 20, 700, 5000])
    def test_search_of_variants_equals_brute_force(self, toy_index: PoseIndex, k: int) -> None:
        noise = np.random.default_rng(1).normal(0, 0.3, (6, 48)).astype(np.float32)
        queries = toy_index.vectors[:576:96] + noise
        queries = np.stack([queries, toy_index.descriptor.mirror(queries), queries[::-1]], axis=1)
        numbers, variants = toy_index.search(queries, k)
        apart = np.linalg.norm(
            queries[:, :, None].astype(np.float64) - toy_index.vectors[:], axis=-1
        ).reshape(len(queries), -1)
        nearest = np.sort(apart, axis=1)[:, :k]
        assert numbers.shape == variants.shape == nearest.shape
        found = variants * len(toy_index) + numbers
        assert all(len(set(row)) == len(row) for row in found.tolist())
        # The same entries in the same order, but for ties within the rounding of FAISS.
        assert_allclose(np.take_along_axis(apart, found, axis=1), nearest, atol=5e-3)
        settled = np.diff(np.sort(apart, axis=1), axis=1, prepend=-1, append=1e9) > 0.01
        settled = (settled[:, :-1] & settled[:, 1:])[:, :k]
        expected = np.argsort(apart, axis=1, kind="stable")[:, :k]
        assert settled.any()
        assert_array_equal(found[settled], expected[settled])

    def test_equal_distances_come_in_the_order_of_variants_and_entries(
        self, toy_index: PoseIndex
    ) -> None:
        vectors = np.tile(toy_index.vectors[:144], (4, 1))
        index = dataclasses.replace(toy_index, vectors=ExactNeighbours(vectors))
        queries = np.repeat(vectors[None, 3:4], 2, axis=1)
        numbers, variants = index.search(queries, 8)
        assert numbers[0].tolist() == 2 * [3, 147, 291, 435]
        assert variants[0].tolist() == 4 * [0] + 4 * [1]


class TestEntries:
    @pytest.mark.parametrize("azimuth", [0.0, -0.0, 1e-20, 360.0, 359.99998])
    def test_azimuth_of_a_mirror_image_stays_below_360(
        self, toy_index: PoseIndex, azimuth: float
    ) -> None:
        entries = toy_index.entries.copy()
        entries["azimuth_deg"][7] = azimuth
        index = dataclasses.replace(toy_index, entries=entries)
        for mirrored in (False, True):
            assert 0 <= index.label(7, mirrored=mirrored).azimuth_deg < 360

    @pytest.mark.parametrize("number", [-1, 576])
    def test_entry_out_of_range_is_refused(self, toy_index: PoseIndex, number: int) -> None:
        with pytest.raises(IndexError, match=f"expected an entry from 0 to 575, got {number}"):
            toy_index.entry(number)
