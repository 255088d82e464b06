"""Keypoints of one person: the window about them, and the right one of several people."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.geometry import COCO_NAMES, Box
from app.vision.movenet import LONG_PX, ROOM, SHORT_PX, KeypointReader, keypoint_window

sides, places = st.floats(1, 900), st.floats(-300, 900)


@given(places, places, sides, sides)
def test_the_person_is_in_the_middle_of_the_window_with_room(
    x: float, y: float, width: float, height: float
) -> None:
    box = Box(x, y, width, height)
    (left, top, columns, rows), shown_columns, shown_rows = keypoint_window(box)
    # Whole pixels: up to one and a half of them on each side.
    assert left - 1.5 <= box.x and box.right <= left + columns + 0.5
    assert top - 1.5 <= box.y and box.bottom <= top + rows + 0.5
    assert abs(left - 0.5 + columns / 2 - (x + width / 2)) <= 1
    assert abs(top - 0.5 + rows / 2 - (y + height / 2)) <= 1
    assert max(width / columns, height / rows) == pytest.approx(1 / ROOM, rel=0.6 / min(columns, 1))
    # The long side is along the person, and nothing is squeezed.
    assert (shown_columns, shown_rows) == (
        (LONG_PX, SHORT_PX) if width > height else (SHORT_PX, LONG_PX)
    )
    assert abs(columns * shown_rows - rows * shown_columns) <= max(shown_rows, shown_columns)


def test_keypoints_lie_in_the_box_and_the_head_is_up(
    reader: KeypointReader, street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    for box in (*walkers, *far_walkers):
        seen = reader.read(street, box)
        assert seen is not None
        reach = 0.1 * box.height
        x, y = seen.positions.T
        assert ((x > box.x - reach) & (x < box.right + reach)).all()
        assert ((y > box.y - reach) & (y < box.bottom + reach)).all()
        rows = dict(zip(COCO_NAMES, y, strict=True))
        for side in ("left", "right"):
            order = [rows[f"{side}_{name}"] for name in ("ear", "shoulder", "hip", "knee", "ankle")]
            assert order == sorted(order)


def test_the_right_one_of_two_neighbours_is_read(
    reader: KeypointReader, street: NDArray[np.uint8], far_walkers: list[Box]
) -> None:
    """They stand a body's width apart: each is in the window of the other."""
    left, right = far_walkers
    (x, _, columns, _), _, _ = keypoint_window(left)
    assert right.x < x + columns
    for box in far_walkers:
        seen = reader.read(street, box)
        assert seen is not None
        assert box.x < np.median(seen.positions[:, 0]) < box.right


@pytest.mark.parametrize("level", [0, 127, 255])
def test_where_nobody_is_nothing_is_read(reader: KeypointReader, level: int) -> None:
    blank = np.full((240, 320, 3), level, np.uint8)
    assert reader.read(blank, Box(100, 40, 60, 150)) is None


@pytest.mark.parametrize("box", [Box(-40, -30, 20, 60), Box(60, 200, 30, 80)])
def test_a_box_beside_people_has_none_of_theirs(
    reader: KeypointReader, street: NDArray[np.uint8], box: Box
) -> None:
    assert reader.read(street, box) is None


@pytest.mark.parametrize("box", [Box(5, 5, 1, 1), Box(0, 0, 298, 2), Box(-500, 20, 2000, 100)])
def test_odd_boxes_are_survived(
    reader: KeypointReader, street: NDArray[np.uint8], box: Box
) -> None:
    seen = reader.read(street, box)
    assert seen is None or np.isfinite(seen.positions).all()
