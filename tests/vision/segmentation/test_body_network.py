"""The body network: the windows it sees, and what it makes of them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.vision.people import Box
from app.vision.resampling import cut, resize
from app.vision.runtime.tflite import NetworkError, TfliteNetwork
from app.vision.segmentation.body_network import (
    COLUMNS,
    ROWS,
    BodyNetwork,
    body_window,
    resampled,
)
from app.vision.weights import network_path
from scripts.convert_body_mask import mask_network

places, sides = st.floats(-300, 900), st.floats(1, 900)


@given(places, places, sides, sides)
def test_the_body_is_in_the_middle_of_its_window(
    x: float, y: float, width: float, height: float
) -> None:
    box = Box(x, y, width, height)
    left, top, columns, rows = body_window(box, 600)
    assert left - 1.5 <= box.x and box.right <= left + columns + 0.5
    assert top - 1.5 <= box.y and box.bottom <= top + rows + 0.5
    assert abs(left + columns / 2 - 0.5 - (box.x + box.width / 2)) <= 1
    assert columns == pytest.approx(rows * COLUMNS / ROWS, abs=1)


def test_a_body_that_the_frame_cuts_goes_on_beyond_it() -> None:
    whole = Box(100.0, 49.5, 80.0, 200.0)
    upper, lower = Box(100.0, 49.5, 80.0, 110.0), Box(100.0, -0.5, 80.0, 150.0)
    expected = body_window(whole, 400)
    assert body_window(upper, 160) == expected
    assert body_window(lower, 400) == (expected[0], expected[1] - 100, *expected[2:])
    assert body_window(upper, 400)[3] < expected[3]
    # Of who is cut above and below, as much is missing on either side.
    left, top, width, height = body_window(Box(100.0, -0.5, 80.0, 100.0), 100)
    assert (left, width, height) == (expected[0], *expected[2:])
    assert top + height / 2 == pytest.approx(50, abs=1)


def test_the_body_in_the_middle_is_marked_and_no_other(
    body: BodyNetwork, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    for box in walkers:
        left, top, width, height = window = body_window(box, len(street))
        marked = body.probability(street, window) > 0.5
        rows, columns = np.nonzero(marked)
        x, y = left + (columns + 0.5) * width / COLUMNS, top + (rows + 0.5) * height / ROWS
        inside = (x > box.x) & (x < box.right) & (y > box.y) & (y < box.bottom)
        assert inside.mean() > 0.9
        assert 0.25 < inside.sum() * width * height / (ROWS * COLUMNS) / box.area < 0.75


@pytest.mark.parametrize("box", [Box(-30, -20, 50, 60), Box(5, 5, 1, 1), Box(0, 0, 300, 2)])
def test_odd_windows_are_survived(body: BodyNetwork, box: Box) -> None:
    found = body.probability(np.full((3, 90, 3), 127, np.uint8), body_window(box, 3))
    assert found.shape == (ROWS, COLUMNS)
    assert np.isfinite(found).all() and found.min() >= 0 and found.max() <= 1


def test_threads_agree(body: BodyNetwork, street: NDArray[np.uint8], walkers: list[Box]) -> None:
    window = body_window(walkers[0], len(street))
    expected = body.probability(street, window)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: body.probability(street, window), range(8)):
            assert_array_equal(found, expected)


def test_another_network_is_refused() -> None:
    with pytest.raises(NetworkError, match="expected"):
        BodyNetwork(network_path("movenet"))


SEEN = np.random.default_rng(1).random((64, 48), np.float32)


def test_a_window_resampled_to_itself_is_the_same() -> None:
    window = (-7, 12, 96, 128)
    assert_allclose(resampled(SEEN, window, window, 48, 64), SEEN, atol=1e-6)


@given(x=st.integers(-60, 60), y=st.integers(-80, 80))
def test_what_another_window_holds_is_moved(x: int, y: int) -> None:
    """By whole pixels of what was seen: each is two of the frame."""
    found = resampled(SEEN, (0, 0, 96, 128), (2 * x, 2 * y, 96, 128), 48, 64)
    assert_allclose(found, cut(SEEN, (x, y, 48, 64)), atol=1e-6)


@given(
    left=st.integers(-90, 90), top=st.integers(-90, 90), width=st.integers(5, 90),
    height=st.integers(5, 90),
)  # fmt: skip
def test_a_slope_is_the_same_slope_in_any_window(
    left: int, top: int, width: int, height: int
) -> None:
    """Seen is x + 10 y in pixels of the frame; bilinear sampling keeps planes."""
    rows, columns = np.mgrid[:64, :48].astype(np.float32)
    plane = (2 * columns + 0.5) + 10 * (2 * rows + 0.5)
    found = resampled(plane, (0, 0, 96, 128), (left, top, width, height), 2 * width, 2 * height)
    y, x = np.mgrid[: 2 * height, : 2 * width] / 2 - 0.25 + np.array([[[top]], [[left]]])
    inside = (x > 1) & (x < 94) & (y > 1) & (y < 126)
    # OpenCV samples at 32nds of a pixel, each of which is two of the frame.
    assert np.abs(found - (x + 10 * y))[inside].max(initial=0) <= 11 * 2 / 32


SHIPPED = network_path("body_mask")
MASK = "Identity_2"


def test_a_network_as_wide_as_before_gives_the_same_mask(tmp_path: Path) -> None:
    kept = tmp_path / "kept.tflite"
    kept.write_bytes(mask_network(SHIPPED.read_bytes(), COLUMNS, MASK))
    image = np.random.default_rng(3).random((ROWS, COLUMNS, 3), np.float32)
    (whole,), (same,) = (
        TfliteNetwork(path, image.shape, [(ROWS, COLUMNS, 1)]).run(image)
        for path in (SHIPPED, kept)
    )
    assert_array_equal(whole, same)


def test_a_wider_network_sees_the_same_person(
    tmp_path: Path, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """As wide as it was before it was made narrower, it marks the same in the middle."""
    wide = tmp_path / "wide.tflite"
    wide.write_bytes(mask_network(SHIPPED.read_bytes(), ROWS))
    left, top, width, height = body_window(walkers[2], len(street))
    window = (left - (height - width) // 2, top, height, height)
    image = resize(cut(street, window), ROWS, ROWS)[..., ::-1].astype(np.float32) / 255
    middle = slice((ROWS - COLUMNS) // 2, (ROWS + COLUMNS) // 2)
    (before,) = TfliteNetwork(wide, (ROWS, ROWS, 3), [(ROWS, ROWS, 1)]).run(image)
    (found,) = TfliteNetwork(SHIPPED, (ROWS, COLUMNS, 3), [(ROWS, COLUMNS, 1)]).run(
        np.ascontiguousarray(image[:, middle])
    )
    first, second = before[:, middle] > 0, found > 0
    assert (first & second).sum() / (first | second).sum() > 0.85


def test_an_output_that_is_not_there_is_told() -> None:
    with pytest.raises(ValueError, match="expected a network with an output nothing"):
        mask_network(SHIPPED.read_bytes(), mask="nothing")
