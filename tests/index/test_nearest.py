"""The entries nearest to a silhouette: exactly, in order, with a confidence by reprojection."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from index.candidates import RotatedQuery, silhouette_rotations
from index.matching import Query
from index.nearest import (
    match_nearest,
    nearest_entries,
    reprojection_confidence,
    reprojection_errors,
)
from index.search import STEPS_PER_UNIT, ExactNeighbours
from index.skeleton import rows
from index.store import PoseIndex

(HEAD,) = rows("head")
PIXELS = st.floats(0, 60)


@pytest.fixture(scope="module")
def in_bytes(tiny_index: PoseIndex) -> PoseIndex:
    """The tiny index with vectors of whole steps, which the usual search keeps as bytes."""
    vectors = np.rint(tiny_index.vectors[:] * STEPS_PER_UNIT) / STEPS_PER_UNIT
    return replace(tiny_index, vectors=ExactNeighbours(np.clip(vectors, -15, 15)))


def shifted(silhouette: NDArray[np.uint8], columns: int) -> NDArray[np.uint8]:
    return np.roll(silhouette, columns, axis=1)


@pytest.mark.parametrize("entry", range(0, 96, 7))
def test_the_search_is_that_by_brute_force(in_bytes: PoseIndex, entry: int) -> None:
    assert in_bytes.vectors.rounds_queries
    silhouette = shifted(in_bytes.silhouette(entry), 1)
    found = nearest_entries(in_bytes, silhouette, 20)
    rotations = silhouette_rotations(silhouette, 0.0)
    rotated = [RotatedQuery.of(silhouette, rotation).silhouette for rotation in rotations]
    queries = in_bytes.descriptor.describe(np.stack(rotated))
    vectors = in_bytes.vectors[:]
    both = np.stack([vectors, in_bytes.descriptor.mirror(vectors)])
    apart = np.linalg.norm(both[:, :, None].astype(np.float64) - queries, axis=-1)
    assert found.distances == pytest.approx(np.sort(apart.ravel())[:20], rel=1e-5)
    used = [rotations.index(rotation) for rotation in found.rotation_deg.tolist()]
    assert found.distances == pytest.approx(
        apart[found.mirrored.astype(int), found.entry_ids, used], rel=1e-5
    )


def test_queries_are_not_rounded(in_bytes: PoseIndex) -> None:
    exact = in_bytes.exact
    query = in_bytes.vectors[:1] + np.float32(0.4 / STEPS_PER_UNIT)
    (squared,), _ = exact.neighbours.search(query, 1)
    assert squared[0] == pytest.approx(query.shape[1] * (0.4 / 8) ** 2, rel=1e-3)
    (rounded,), _ = in_bytes.neighbours.search(query, 1)
    assert rounded[0] == 0
    assert exact.exact is exact


def test_another_search_is_asked_what_this_process_would_compare(in_bytes: PoseIndex) -> None:
    vectors = in_bytes.vectors[:]
    elsewhere = replace(in_bytes, searched_by=ExactNeighbours(vectors, in_bytes=False))
    queries = vectors[:9, None] + np.random.default_rng(0).normal(0, 0.3, vectors[:9, None].shape)
    for here, there in zip(
        in_bytes.search(queries, 20), elsewhere.search(queries, 20), strict=True
    ):
        assert np.array_equal(here, there)


def test_hypotheses_are_entries_as_they_are_nearest_first(tiny_index: PoseIndex) -> None:
    silhouette = shifted(tiny_index.silhouette(5), 1)
    found = match_nearest(tiny_index, silhouette, 12).hypotheses
    distances = [one.distance for one in found]
    assert len(found) == 12
    assert distances == sorted(distances)
    for one in found:
        assert one.adjusted_m == pytest.approx(0, abs=1e-9)
        assert 0 < one.confidence < 1
    few = match_nearest(tiny_index, silhouette, 3).hypotheses
    assert [one.entry_id for one in few] == [one.entry_id for one in found[: len(few)]]


@pytest.mark.parametrize("entry", [0, 8, 33])
def test_an_entry_is_nearest_to_its_own_silhouette(tiny_index: PoseIndex, entry: int) -> None:
    found = match_nearest(tiny_index, tiny_index.silhouette(entry), 7)
    best = found.hypotheses[0]
    assert (best.entry_id, best.mirrored) == (entry, False)
    assert best.distance == pytest.approx(0, abs=1e-3)
    assert best.reprojection_error_px == 0
    assert best.confidence == max(one.confidence for one in found.hypotheses)


@given(first=st.tuples(PIXELS, PIXELS), more=st.tuples(PIXELS, PIXELS))
def test_the_confidence_never_rises_with_the_reprojection_error(
    first: tuple[float, float], more: tuple[float, float]
) -> None:
    better, worse = reprojection_confidence(np.array([first, np.add(first, more)]))
    assert worse <= better


def test_the_confidence_falls_as_the_outline_gets_worse(tiny_index: PoseIndex) -> None:
    silhouette = tiny_index.silhouette(8)
    confidences = []
    for reach in (0, 2, 4, 8):
        kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        grown = cv2.dilate(silhouette, kernel)
        entries = nearest_entries(tiny_index, silhouette, 1)
        errors = reprojection_errors(Query(tiny_index, grown, 0.0), entries)
        confidences.append(float(reprojection_confidence(errors)[0]))
    assert confidences == sorted(confidences, reverse=True)
    assert confidences[0] > confidences[-1] + 0.1


def test_the_confidence_falls_as_a_joint_leaves_the_silhouette(tiny_index: PoseIndex) -> None:
    silhouette = tiny_index.silhouette(8)
    entries = nearest_entries(tiny_index, silhouette, 1)
    query, confidences = Query(tiny_index, silhouette, 0.0), []
    for away in range(0, 60, 10):
        points = entries.points_normalised.copy()
        points[0, HEAD, 1] -= away
        moved = replace(entries, points_normalised=points)
        confidences.append(float(reprojection_confidence(reprojection_errors(query, moved))[0]))
    assert confidences == sorted(confidences, reverse=True)
    assert confidences[0] > confidences[-1]
