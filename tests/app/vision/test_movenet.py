"""MoveNet: the people of the published graph, any number of them, wherever they are."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.movenet import (
    CELL_PX,
    KEYPOINTS,
    LEAST_KEYPOINT_SCORE,
    MoveNet,
    MoveNetDetection,
    decode,
)
from tests.conftest import ROOT


def corners(box: Box) -> list[float]:
    return [box.x, box.y, box.right, box.bottom]


def about(people: list[MoveNetDetection], box: Box) -> MoveNetDetection:
    """Who is in a box: at least half of both is shared."""
    best = max(people, key=lambda one: one.box.iou(box))
    assert best.box.iou(box) > 0.5, f"expected somebody in {box}, got {best.box} at most"
    return best


SIZE = 320
"""Sides of the picture that the published graph was shown."""


@pytest.fixture(scope="module")
def published() -> NDArray[np.float64]:
    return np.array(json.loads((ROOT / "tests" / "data" / "movenet-walkers.json").read_text()))


@pytest.fixture(scope="module")
def ours(movenet: MoveNet, street: NDArray[np.uint8]) -> list[MoveNetDetection]:
    return movenet.people(cv2.resize(street, (SIZE, SIZE), interpolation=cv2.INTER_AREA))


class TestPublishedGraph:
    """What the graph as Google published it gives for the same picture; see tests/data."""

    def test_finds_the_same_people(
        self, published: NDArray[np.float64], ours: list[MoveNetDetection]
    ) -> None:
        # Weights are the same float16 numbers: sums in another order are all that differs, which
        # moved nothing by more than 1e-4 px here. A tenth of a pixel is far below what
        # any slip of half a pixel, a cell or a side would move.
        assert len(ours) >= len(published) == 6
        for row, person in zip(published, ours, strict=False):
            top, left, bottom, right = SIZE * row[51:55] - 0.5
            assert_allclose(corners(person.box), [left, top, right, bottom], atol=0.1)
            # Where two people claim one keypoint, the published graph gives both the higher score.
            assert person.score == pytest.approx(row[55], abs=0.01)
        assert [one.score for one in ours[:4]] == pytest.approx(published[:4, 55], abs=1e-3)

    def test_sees_the_same_keypoints(
        self, published: NDArray[np.float64], ours: list[MoveNetDetection]
    ) -> None:
        for number, (row, person) in enumerate(zip(published, ours, strict=False)):
            y, x, scores = row[:51].reshape(KEYPOINTS, 3).T
            places = SIZE * np.stack([x, y], axis=-1) - 0.5
            assert_allclose(person.keypoints.positions, places, atol=0.1)
            atol = 1e-3 if number < 4 else 0.05  # As above.
            assert_allclose(person.keypoints.scores, scores, atol=atol)


def test_more_people_than_the_published_graph_gives(
    movenet: MoveNet, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    height, width = street.shape[:2]
    found = movenet.people(np.tile(street, (2, 2, 1)))
    seen = {
        id(about(found, Box(box.x + x, box.y + y, box.width, box.height)))
        for x in (0, width)
        for y in (0, height)
        for box in walkers
    }
    assert len(seen) == 12
    assert sum(one.score > 0.3 for one in found) >= 12


@pytest.mark.parametrize(("x", "y"), [(32, 0), (0, 32), (16, 8), (5, 3)])
def test_people_move_with_the_picture(
    movenet: MoveNet, street: NDArray[np.uint8], walkers: list[Box], x: int, y: int
) -> None:
    here, there = (
        movenet.people(cv2.copyMakeBorder(street, *sides, cv2.BORDER_REPLICATE))
        for sides in ((0, y, 0, x), (y, 0, x, 0))
    )
    whole = x % 32 == y % 32 == 0
    for walker in walkers:
        one = about(here, walker)
        other = about(there, Box(walker.x + x, walker.y + y, walker.width, walker.height))
        moved = np.add(corners(one.box), (x, y, x, y))
        # By whole steps of the network all stays; else it sees another sampling: half a cell.
        assert_allclose(corners(other.box), moved, atol=0.5 if whole else 2)
        apart = other.keypoints.positions - one.keypoints.positions - (x, y)
        assert np.median(np.linalg.norm(apart, axis=1)) < (0.5 if whole else 1.5)


@pytest.mark.parametrize("cut", [1, 7, 31])
def test_sides_that_are_no_multiples_of_32_change_nothing(
    movenet: MoveNet, street: NDArray[np.uint8], walkers: list[Box], cut: int
) -> None:
    """Rows of asphalt below the walkers, cut off or black."""
    assert street.shape[0] % 32 == 0
    black = street.copy()
    black[-cut:] = 0
    padded, whole = movenet.people(street[:-cut]), movenet.people(black)
    assert len(padded) == len(whole)
    for one, other in zip(padded, whole, strict=True):
        assert_array_equal(one.keypoints.positions, other.keypoints.positions)
        assert one.box == other.box


CELLS = (40, 48)


def heads_of(people: list[tuple[Box, NDArray[np.float64], float]]) -> list[NDArray[np.float32]]:
    """Heads that show people of given boxes, keypoints ``(17, 2)`` in pixels, and scores."""
    heads = [np.zeros((*CELLS, channels), np.float32) for channels in (1, 2, 2, 34, 17, 34)]
    centres, sizes, offsets, guesses, heatmaps, places = heads
    for box, points, score in people:
        cells = (points[:, ::-1] + 0.5) / CELL_PX
        middle = np.array([box.y + box.height / 2, box.x + box.width / 2])
        middle = (middle + 0.5) / CELL_PX
        row, column = np.floor(middle).astype(int)
        centres[row, column] = score
        sizes[row, column] = np.array([box.height, box.width]) / CELL_PX
        offsets[row, column] = middle - (row, column)
        # The guess is good to a cell; the heatmap's peak and the place in its cell tell exactly.
        guesses[row, column] = (cells - (row, column) + 0.7).ravel()
        for number, (y, x) in enumerate(np.floor(cells).astype(int)):
            heatmaps[y, x, number] = 0.9
            places[y, x, 2 * number : 2 * number + 2] = cells[number] - (y, x)
    return heads


@given(seed=st.integers(0, 9999), count=st.integers(0, 12))
def test_what_heads_show_is_decoded(seed: int, count: int) -> None:
    """Boxes and keypoints of any number of people, each in a field of its own."""
    rng = np.random.default_rng(seed)
    people = []
    for place in rng.permutation(12)[:count]:
        left, top = 48.0 * (place % 4), 53.0 * (place // 4)
        size = rng.uniform(20, 40, 2)
        box = Box(left + 3, top + 3, *size)
        # As in the published graph, the first cell that a box cuts is not searched.
        points = np.array([left + 3, top + 3]) + rng.uniform(CELL_PX, size - 1, (KEYPOINTS, 2))
        people.append((box, points, float(rng.uniform(0.1, 1))))
    found = decode(heads_of(people), 0.05)
    assert [one.centre_score for one in found] == sorted(
        (one.centre_score for one in found), reverse=True
    )
    assert len(found) == count
    for one, (box, points, score) in zip(
        found, sorted(people, key=lambda person: -person[2]), strict=True
    ):
        assert one.centre_score == pytest.approx(score)
        assert_allclose(corners(one.box), corners(box), atol=1e-3)
        assert_allclose(one.keypoints.positions, points, atol=1e-3)
        seen = one.keypoints.scores > LEAST_KEYPOINT_SCORE
        assert one.score == pytest.approx(score * one.keypoints.scores[seen].mean(), rel=1e-4)
    assert len(decode(heads_of(people), 1.01)) == 0


def test_a_keypoint_that_another_claims_is_taken_by_who_is_nearer() -> None:
    """Two shoulder to shoulder: each heatmap has both peaks within both boxes."""
    left, right = Box(10, 10, 80, 100), Box(40, 10, 80, 100)
    people = [(left, np.full((17, 2), 42.0), 0.8), (right, np.full((17, 2), 86.0), 0.9)]
    found = decode(heads_of(people), 0.05)
    for one, (_, points, _) in zip(found, people[::-1], strict=True):
        assert_allclose(one.keypoints.positions, points, atol=1e-3)
