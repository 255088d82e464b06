"""The segmentation networks: the windows they see, and what they make of them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.networks import BODY_FILE, COLUMNS, ROWS, SIZE, Networks, body_window
from app.vision.people import Box
from app.vision.resampling import cut, resize
from app.vision.tflite import TfliteNetwork
from scripts.body_mask import mask_network

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
    networks: Networks, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    for box in walkers:
        left, top, width, height = window = body_window(box, len(street))
        marked = networks.body.probability(street, window) > 0.5
        rows, columns = np.nonzero(marked)
        x, y = left + (columns + 0.5) * width / COLUMNS, top + (rows + 0.5) * height / ROWS
        inside = (x > box.x) & (x < box.right) & (y > box.y) & (y < box.bottom)
        assert inside.mean() > 0.9
        assert 0.25 < inside.sum() * width * height / (ROWS * COLUMNS) / box.area < 0.75


@pytest.mark.parametrize("box", [Box(-30, -20, 50, 60), Box(5, 5, 1, 1), Box(0, 0, 300, 2)])
def test_odd_windows_are_survived(networks: Networks, box: Box) -> None:
    found = networks.body.probability(np.full((3, 90, 3), 127, np.uint8), body_window(box, 3))
    assert found.shape == (ROWS, COLUMNS)
    assert np.isfinite(found).all() and found.min() >= 0 and found.max() <= 1


def test_threads_agree(networks: Networks, street: NDArray[np.uint8], walkers: list[Box]) -> None:
    window = body_window(walkers[0], len(street))
    expected = networks.body.probability(street, window)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: networks.body.probability(street, window), range(8)):
            np.testing.assert_array_equal(found, expected)


MASK = "activation_10"
"""The only output of the network that is fetched whole."""


def test_a_network_as_wide_as_before_gives_the_same_mask(
    person_model: Path, tmp_path: Path
) -> None:
    kept = tmp_path / "kept.tflite"
    kept.write_bytes(mask_network(person_model.read_bytes(), SIZE, MASK))
    image = np.random.default_rng(3).random((SIZE, SIZE, 3), np.float32)
    whole, same = (
        TfliteNetwork(path, image.shape, (SIZE, SIZE, 1)).run(image)
        for path in (person_model, kept)
    )
    np.testing.assert_array_equal(whole, same)


def test_a_wider_network_sees_the_same_person(
    models: Path, tmp_path: Path, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """As wide as it was before it was made narrower, it marks the same in the middle."""
    narrow, wide = models / BODY_FILE, tmp_path / "wide.tflite"
    wide.write_bytes(mask_network(narrow.read_bytes(), ROWS))
    left, top, width, height = body_window(walkers[2], len(street))
    window = (left - (height - width) // 2, top, height, height)
    image = resize(cut(street, window), ROWS, ROWS)[..., ::-1].astype(np.float32) / 255
    middle = slice((ROWS - COLUMNS) // 2, (ROWS + COLUMNS) // 2)
    before = TfliteNetwork(wide, (ROWS, ROWS, 3), (ROWS, ROWS, 1)).run(image)[:, middle] > 0
    found = TfliteNetwork(narrow, (ROWS, COLUMNS, 3), (ROWS, COLUMNS, 1)).run(
        np.ascontiguousarray(image[:, middle])
    )
    assert ((found > 0) & before).sum() / ((found > 0) | before).sum() > 0.85


def test_an_output_that_is_not_there_is_told(person_model: Path) -> None:
    with pytest.raises(ValueError, match="expected a network with an output nothing"):
        mask_network(person_model.read_bytes(), mask="nothing")
