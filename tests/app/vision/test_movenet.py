"""MoveNet: the people that Google's graph finds and more, and the keypoints of one in a box."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.movenet import (
    KEYPOINT_WINDOW_PX,
    KEYPOINT_WINDOW_SCALE,
    KeypointReader,
    MoveNet,
    MoveNetDetection,
    keypoint_window,
)
from tests.app.vision.conftest import moved
from tests.conftest import ROOT


def corners(box: Box) -> list[float]:
    return [box.x, box.y, box.right, box.bottom]


def person_in(box: Box, people: list[MoveNetDetection]) -> MoveNetDetection:
    best = max(people, key=lambda one: one.box.iou(box))
    assert best.box.iou(box) > 0.5, f"expected a person in {box}, the nearest is in {best.box}"
    return best


SIZE = 320
"""Sides of the image that Google's graph was given."""


@pytest.fixture(scope="module")
def published() -> NDArray[np.float64]:
    return np.array(json.loads((ROOT / "tests" / "data" / "movenet-walkers.json").read_text()))


@pytest.fixture(scope="module")
def ours(movenet: MoveNet, street: NDArray[np.uint8]) -> list[MoveNetDetection]:
    return movenet.detect(cv2.resize(street, (SIZE, SIZE), interpolation=cv2.INTER_AREA))


def test_people_are_those_of_the_published_graph(
    published: NDArray[np.float64], ours: list[MoveNetDetection]
) -> None:
    """What Google's graph gives for the same image; see tests/data.

    The backbone is rounded to 8 bits, which moves most joints by a quarter of a pixel. A slip of
    half a pixel, a cell or a side would move all of them further.
    """
    assert len(ours) >= len(published) == 6
    for row, person in zip(published, ours, strict=False):
        top, left, bottom, right = SIZE * row[51:55] - 0.5
        assert_allclose(corners(person.box), [left, top, right, bottom], atol=2)
        y, x, scores = row[:51].reshape(17, 3).T
        gaps = person.keypoints.positions - (SIZE * np.stack([x, y], axis=-1) - 0.5)
        assert np.median(np.linalg.norm(gaps, axis=1)) < 0.5
        assert np.linalg.norm(gaps, axis=1)[scores > 0.2].max() < 2.5
        assert person.score == pytest.approx(row[55], abs=0.02)
        assert_allclose(person.keypoints.scores, scores, atol=0.1)


@pytest.mark.parametrize(("x", "y"), [(32, 0), (0, 32), (16, 8), (5, 3)])
def test_people_move_with_the_image(
    movenet: MoveNet, street: NDArray[np.uint8], walkers: list[Box], x: int, y: int
) -> None:
    here, there = (
        movenet.detect(cv2.copyMakeBorder(street, *sides, cv2.BORDER_REPLICATE))
        for sides in ((0, y, 0, x), (y, 0, x, 0))
    )
    whole = x % 32 == y % 32 == 0
    for walker in walkers:
        one, other = person_in(walker, here), person_in(moved(walker, x, y), there)
        # By whole steps of the network only surroundings change, and with them some roundings; else
        # it sees another sampling: half a cell.
        expected = corners(moved(one.box, x, y))
        assert_allclose(corners(other.box), expected, atol=1 if whole else 2)
        offsets = other.keypoints.positions - one.keypoints.positions - (x, y)
        assert np.median(np.linalg.norm(offsets, axis=1)) < (0.5 if whole else 1.5)


sides, places = st.floats(1, 900), st.floats(-300, 900)


@given(places, places, sides, sides)
def test_person_is_in_the_middle_of_the_keypoint_window(
    x: float, y: float, width: float, height: float
) -> None:
    box = Box(x, y, width, height)
    (left, top, columns, rows), *shown = keypoint_window(box)
    # Whole pixels: up to one and a half of them on each side.
    assert left - 1.5 <= box.x and box.right <= left + columns + 0.5
    assert top - 1.5 <= box.y and box.bottom <= top + rows + 0.5
    assert abs(left - 0.5 + columns / 2 - (x + width / 2)) <= 1
    assert abs(top - 0.5 + rows / 2 - (y + height / 2)) <= 1
    share = max(width / columns, height / rows)
    assert share == pytest.approx(1 / KEYPOINT_WINDOW_SCALE, rel=0.6 / min(columns, rows))
    # The long side is along the person, and nothing is squeezed.
    assert tuple(shown) == KEYPOINT_WINDOW_PX[:: 1 if width > height else -1]
    assert abs(columns * shown[1] - rows * shown[0]) <= max(shown)


def test_right_one_of_two_neighbours_is_read(
    reader: KeypointReader, street: NDArray[np.uint8], far_walkers: list[Box]
) -> None:
    """They stand a body's width apart: each is in the window of the other."""
    (x, _, columns, _), _, _ = keypoint_window(far_walkers[0])
    assert far_walkers[1].x < x + columns
    for box in far_walkers:
        seen = reader.read(street, box)
        assert seen is not None
        assert box.x < np.median(seen.positions[:, 0]) < box.right
