"""The nearest entries and mirror images: the same as by hand, and symmetric under mirroring."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from index.candidates import compare_entries, find_candidates
from index.skeleton import POINTS, mirror_3d, mirror_normalised
from index.store import PoseIndex

QUERIES = range(3, 576, 83)
ATOL = 1e-4
"""Descriptors are float32, of values about 50."""


@pytest.mark.parametrize("number", QUERIES)
class TestCandidates:
    def test_mirrored_entry_is_found_as_its_mirror_image(
        self, toy_index: PoseIndex, number: int
    ) -> None:
        found = find_candidates(toy_index, toy_index.silhouette(number)[:, ::-1], 5)
        assert (found.entry_ids[0], found.mirrored[0]) == (number, True)
        assert found.distances[0] == pytest.approx(0, abs=ATOL)
        entry = toy_index.entry(number)
        assert_allclose(found.points_3d[0], mirror_3d(entry.points_3d))
        assert_allclose(found.points_normalised[0], mirror_normalised(entry.points_normalised))

    def test_mirrored_silhouette_has_mirrored_candidates(
        self, toy_index: PoseIndex, number: int
    ) -> None:
        silhouette = toy_index.silhouette(number)
        here, there = (
            find_candidates(toy_index, s, 2 * len(toy_index))
            for s in (silhouette, silhouette[:, ::-1])
        )
        assert_allclose(there.distances, here.distances, atol=ATOL)
        distance = dict(
            zip(zip(here.entry_ids, here.mirrored, strict=True), here.distances, strict=True)
        )
        for entry, mirrored, apart in zip(
            there.entry_ids, there.mirrored, there.distances, strict=True
        ):
            assert distance[entry, not mirrored] == pytest.approx(apart, abs=ATOL)

    def test_equals_brute_force(self, toy_index: PoseIndex, number: int) -> None:
        found = find_candidates(toy_index, toy_index.silhouette(number), 30)
        assert_allclose(found.distances, np.linalg.norm(found.offsets, axis=-1), atol=ATOL)
        both = np.concatenate([toy_index.vectors, toy_index.descriptor.mirror(toy_index.vectors)])
        query = toy_index.descriptor.describe(toy_index.silhouette(number)[None])
        all_apart = np.linalg.norm(query.astype(np.float64) - both, axis=-1)
        assert_allclose(found.distances, np.sort(all_apart)[:30], atol=ATOL)


def test_finds_at_most_all_entries_and_their_mirror_images(toy_index: PoseIndex) -> None:
    found = find_candidates(toy_index, toy_index.silhouette(0), 10**6)
    assert len(found) == 2 * len(toy_index)
    assert_array_equal(np.bincount(found.entry_ids), 2)
    assert found.points_3d.shape == (len(found), POINTS, 3)


def test_given_entries_have_the_same_distances(toy_index: PoseIndex) -> None:
    silhouette = toy_index.silhouette(77)
    found = find_candidates(toy_index, silhouette, 25)
    shuffled = np.random.default_rng(0).permutation(25)
    queries = toy_index.descriptor.describe(silhouette[None]).repeat(25, axis=0)
    again = compare_entries(toy_index, queries, found.entry_ids[shuffled], found.mirrored[shuffled])
    assert_allclose(again.distances, found.distances[shuffled], atol=ATOL)
    assert_array_equal(again.entry_ids, found.entry_ids[shuffled])
    assert_allclose(again.offsets, found.offsets[shuffled], atol=1e-4)
    assert_allclose(again.points_3d, found.points_3d[shuffled])
    assert_array_equal(again.in_order().entry_ids, found.entry_ids)
