"""Windows about people: where they are in the frame, and what they show of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from app.vision.geometry import PersonWindow
from app.vision.windows import ROOM, cut_window, window_of_circle, window_to_frame

places, sides, rolls = st.floats(-300, 900), st.floats(1, 900), st.floats(-360, 360)
windows = st.builds(PersonWindow, places, places, sides, rolls)


def to_frame(window: PersonWindow, pixels: int, points: np.ndarray) -> np.ndarray:
    matrix = window_to_frame(window, pixels)
    return points @ matrix[:, :2].T + matrix[:, 2]


@given(window=windows, pixels=st.integers(1, 300))
def test_the_middle_stays_and_all_is_as_large_in_every_direction(
    window: PersonWindow, pixels: int
) -> None:
    middle = np.full(2, (pixels - 1) / 2)
    assert_allclose(to_frame(window, pixels, middle), [window.x, window.y], atol=1e-9)
    linear = window_to_frame(window, pixels)[:, :2]
    assert_allclose(linear.T @ linear, (window.side / pixels) ** 2 * np.eye(2), atol=1e-6)
    assert np.linalg.det(linear) > 0


@given(window=windows, pixels=st.integers(2, 300))
def test_the_head_is_where_the_roll_says(window: PersonWindow, pixels: int) -> None:
    """Up in the window is so far clockwise from up in the frame."""
    middle = np.full(2, (pixels - 1) / 2)
    right, down = to_frame(window, pixels, middle - [0, 1]) - [window.x, window.y]
    angle = np.rad2deg(np.arctan2(right, -down))
    assert (angle - window.roll_deg + 180) % 360 == pytest.approx(180, abs=1e-6)


@given(x=places, y=places, side=sides, roll_deg=rolls, quarter_turns=st.integers(0, 3))
def test_in_a_turned_frame_the_turned_window_holds_the_same(
    x: float, y: float, side: float, roll_deg: float, quarter_turns: int
) -> None:
    """Turned clockwise about the frame's origin, and its axes with it."""
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarter_turns)
    turned = PersonWindow(*(turn @ [x, y]).tolist(), side, roll_deg + 90 * quarter_turns)
    points = np.array([[0.0, 0.0], [63, 0], [63, 63], [12, 40]])
    here = to_frame(PersonWindow(x, y, side, roll_deg), 64, points)
    assert_allclose(to_frame(turned, 64, points), here @ turn.T, atol=1e-6)


@given(x=places, y=places, radius=sides, roll_deg=st.floats(-179, 179))
def test_the_window_of_a_circle_has_its_point_above_the_middle(
    x: float, y: float, radius: float, roll_deg: float
) -> None:
    angle = np.deg2rad(roll_deg)
    window = window_of_circle(
        np.array([x, y]), np.array([x + radius * np.sin(angle), y - radius * np.cos(angle)])
    )
    assert (window.x, window.y) == (x, y)
    assert window.side == pytest.approx(2 * ROOM * radius)
    assert window.roll_deg == pytest.approx(roll_deg, abs=1e-6)


FRAME = np.random.default_rng(5).integers(1, 256, (90, 120, 3), np.uint8)


def window_of_pixels(left: int, top: int, pixels: int, roll_deg: float = 0.0) -> PersonWindow:
    middle = (pixels - 1) / 2
    return PersonWindow(left + middle, top + middle, float(pixels), roll_deg)


@given(left=st.integers(-40, 130), top=st.integers(-40, 100), pixels=st.integers(1, 64))
def test_a_window_of_whole_pixels_shows_those_pixels_and_black_beyond(
    left: int, top: int, pixels: int
) -> None:
    room = 110
    padded = np.pad(FRAME, ((room, room), (room, room), (0, 0)))
    expected = padded[top + room : top + room + pixels, left + room : left + room + pixels]
    assert_array_equal(cut_window(FRAME, window_of_pixels(left, top, pixels), pixels), expected)


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_a_window_turned_by_quarters_shows_the_pixels_turned(quarter_turns: int) -> None:
    upright = cut_window(FRAME, window_of_pixels(20, 10, 50), 50)
    turned = cut_window(FRAME, window_of_pixels(20, 10, 50, 90.0 * quarter_turns), 50)
    assert_array_equal(turned, np.rot90(upright, quarter_turns))


@given(window=windows)
def test_a_plain_frame_is_plain_in_every_window(window: PersonWindow) -> None:
    """At any size: what is averaged before it is sampled neither brightens nor darkens."""
    plain = np.full((90, 120, 3), 200, np.uint8)
    assert cut_window(plain, window, 32).max() <= 200
    corners = to_frame(window, 32, np.array([[0.0, 0.0], [31, 0], [31, 31], [0, 31]]))
    reach = window.side / 16 + 2
    if (corners >= reach).all() and (corners <= [119 - reach, 89 - reach]).all():
        assert (cut_window(plain, window, 32) == 200).all()


@pytest.mark.parametrize("roll_deg", [0.0, 35.0, 180.0])
def test_a_slope_is_the_same_slope_in_a_large_frame(roll_deg: float) -> None:
    """Averaging shifts nothing: where the window is coarser than the frame, planes stay."""
    rows, columns = np.mgrid[:600, :800]
    frame = np.repeat(((columns + rows) * (250 / 1400))[..., None], 3, axis=2).astype(np.uint8)
    window = PersonWindow(403.3, 296.7, 400.0, roll_deg)
    seen = cut_window(frame, window, 32)[..., 0]
    grid = np.stack(np.meshgrid(np.arange(32.0), np.arange(32.0)), axis=-1)
    x, y = np.moveaxis(to_frame(window, 32, grid), -1, 0)
    # Grey levels are cut off to whole numbers twice; one is 5.6 pixels.
    assert np.abs(seen + 0.5 - (x + y) * (250 / 1400)).max() < 1.5
