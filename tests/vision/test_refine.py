"""The network that redraws silhouettes: what it is shown, and what it makes of it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.people import Box
from app.vision.refine import (
    CHANNELS,
    COLUMNS,
    PROBABILITY,
    ROWS,
    WEIGHTS_PATH,
    Refiner,
    moved,
    refiner_input,
    refiner_window,
)

sides = st.floats(1, 900)
places = st.floats(-300, 900)


@pytest.fixture(scope="module")
def refiner() -> Refiner:
    return Refiner()


def planes_of(
    frame: NDArray[np.uint8], box: Box, others: list[Box], probability: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """What the refiner sees where the first networks saw the whole frame."""
    window = refiner_window(box)
    seen = moved(probability, (0, 0, frame.shape[1], frame.shape[0]), window)
    return refiner_input(frame, window, box, others, seen)


@given(places, places, sides, sides)
def test_the_window_holds_the_box(x: float, y: float, width: float, height: float) -> None:
    box = Box(x, y, width, height)
    left, top, columns, rows = refiner_window(box)
    assert left - 1.5 <= box.x and box.right <= left + columns + 0.5
    assert top - 1.5 <= box.y and box.bottom <= top + rows + 0.5
    assert columns >= rows * COLUMNS / ROWS - 1


def test_a_standing_person_fills_the_window() -> None:
    box = Box(100, 50, 90, 300)
    _, _, columns, rows = refiner_window(box)
    assert rows == pytest.approx(1.1 * box.height, abs=1)
    assert columns / rows == pytest.approx(COLUMNS / ROWS, abs=0.01)


@pytest.mark.parametrize("side", [64, 256, 400])
def test_probability_and_box_lie_on_each_other(side: int) -> None:
    """A first network that marks exactly the box, at any resolution, marks it here too."""
    frame = np.zeros((400, 400, 3), np.uint8)
    box = Box(99.5, 49.5, 120, 300)
    marked = np.zeros((400, 400), np.float32)
    marked[50:350, 100:220] = 1
    answer = cv2.resize(marked, (side, side), interpolation=cv2.INTER_AREA)
    planes = planes_of(frame, box, [], answer)
    assert planes.shape == (CHANNELS, ROWS, COLUMNS) and planes.dtype == np.uint8
    differs = (planes[PROBABILITY] > 127) != (planes[4] > 127)
    assert differs.mean() < (0.01 if side >= 256 else 0.04)
    assert not planes[5].any()


def test_what_is_beyond_the_first_networks_window_is_nobody() -> None:
    window = refiner_window(Box(9.5, 9.5, 40, 80))
    inside = moved(np.ones((256, 192), np.float32), (30, 0, 70, 100), window) > 0.5
    edge = (30 - window[0]) * COLUMNS / window[2]
    assert not inside[:, : int(edge) - 1].any() and inside[ROWS // 2, int(edge) + 2 :].all()


def test_mirrored_scenes_give_mirrored_planes() -> None:
    generator = np.random.default_rng(4)
    frame = generator.integers(0, 255, (220, 161, 3), np.uint8)
    probability = generator.random((256, 256), np.float32)
    box, other = Box(39.5, 9.5, 81, 200), Box(99.5, 9.5, 40, 200)
    planes = planes_of(frame, box, [other], probability)
    flipped = planes_of(
        np.ascontiguousarray(frame[:, ::-1]), box, [Box(20.5, 9.5, 40, 200)],
        np.ascontiguousarray(probability[:, ::-1]),
    )  # fmt: skip
    difference = np.abs(planes.astype(int) - flipped[..., ::-1].astype(int))
    assert difference[[0, 1, 2, 4, 5]].max() <= 1 and difference[PROBABILITY].max() < 16


@pytest.mark.parametrize("box", [Box(-30, -20, 50, 60), Box(5, 5, 1, 1), Box(0, 0, 300, 2)])
def test_odd_boxes_are_survived(refiner: Refiner, box: Box) -> None:
    frame = np.full((3, 90, 3), 127, np.uint8)
    found = refiner.probability(planes_of(frame, box, [box], np.zeros((8, 8), np.float32)))
    assert found.shape == (ROWS, COLUMNS)
    assert np.isfinite(found).all() and found.min() >= 0 and found.max() <= 1


def test_threads_agree(refiner: Refiner) -> None:
    planes = np.random.default_rng(2).integers(0, 255, (CHANNELS, ROWS, COLUMNS), np.uint8)
    expected = refiner.probability(planes)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: refiner.probability(planes), range(12)):
            assert (found == expected).all()


def test_it_is_small() -> None:
    assert WEIGHTS_PATH.stat().st_size < 3_000_000


def test_a_lost_arm_and_a_lost_head_come_back(refiner: Refiner) -> None:
    """A plain figure on a plain wall, of which the first networks saw the trunk and legs alone."""
    frame = np.full((300, 300, 3), (150, 160, 155), np.uint8)
    body = np.zeros((300, 300), np.uint8)
    cv2.ellipse(body, (150, 110), (28, 55), 0, 0, 360, 1, -1)
    cv2.line(body, (138, 150), (125, 270), 1, 22)
    cv2.line(body, (162, 150), (178, 270), 1, 22)
    seen = body.copy()
    cv2.line(body, (165, 80), (240, 60), 1, 14)
    cv2.circle(body, (150, 38), 17, 1, -1)
    cv2.line(body, (150, 45), (150, 65), 1, 12)
    frame[body > 0] = (60, 50, 90)
    frame = cv2.GaussianBlur(frame, (0, 0), 1)
    x, y, width, height = cv2.boundingRect(body)
    box = Box(x - 0.5, y - 0.5, width, height)
    probability = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 3)
    found = refiner.probability(planes_of(frame, box, [], probability)) > 0.5
    left, top, columns, rows = refiner_window(box)
    padded = np.pad(body, 200)[top + 200 : top + 200 + rows, left + 200 : left + 200 + columns]
    truth = cv2.resize(padded, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA) > 0
    lost = cv2.resize(
        np.pad(body - seen, 200)[top + 200 : top + 200 + rows, left + 200 : left + 200 + columns],
        (COLUMNS, ROWS), interpolation=cv2.INTER_AREA,
    ) > 0  # fmt: skip
    assert found[lost].mean() > 0.6
    assert (found & truth).sum() / (found | truth).sum() > 0.8
