"""Crops of an image, and windows sampled from a frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from app.vision.geometry import (
    PersonWindow,
    crop,
    crop_and_resize,
    resize,
    sample_window,
    transform_points,
)
from tests.app.vision.conftest import PERSON_WINDOWS


def noise(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(5).integers(1, 256, (height, width, 3), np.uint8)


def padded_crop(image: NDArray[np.uint8], left: int, top: int, width: int, height: int):
    padded = np.pad(image, ((200, 200), (200, 200), (0, 0)))
    return padded[200 + top : 200 + top + height, 200 + left : 200 + left + width]


@given(
    left=st.integers(-30, 60), top=st.integers(-30, 60),
    width=st.integers(1, 70), height=st.integers(1, 70),
)  # fmt: skip
def test_crop_is_zero_beyond_the_image(left: int, top: int, width: int, height: int) -> None:
    rect = (left, top, width, height)
    assert_array_equal(crop(noise(30, 40), rect), padded_crop(noise(30, 40), *rect))


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_shrinking_averages_areas(factor: int) -> None:
    image = noise(30, 60).astype(np.float32)
    blocks = image.reshape(30 // factor, factor, 60 // factor, factor, 3).mean(axis=(1, 3))
    assert np.abs(resize(image, 60 // factor, 30 // factor) - blocks).max() < 1e-3


@given(
    left=st.integers(-12, 12), top=st.integers(-12, 12),
    columns=st.integers(1, 20), rows=st.integers(1, 20),
)  # fmt: skip
def test_large_crops_equal_small_ones_at_whole_factors(
    left: int, top: int, columns: int, rows: int
) -> None:
    rect = (4 * left, 4 * top, 4 * columns, 4 * rows)
    small, large = (
        crop_and_resize(noise(20, 28), rect, columns, rows, max_crop_px)
        for max_crop_px in (2**22, 0)
    )
    assert_array_equal(small, large)


@given(
    left=st.integers(-500, 90), top=st.integers(-500, 90),
    columns=st.integers(60, 900), rows=st.integers(60, 900),
)  # fmt: skip
def test_large_crops_are_accurate_to_a_pixel(left: int, top: int, columns: int, rows: int) -> None:
    image = np.full((80, 100, 3), 255, np.uint8)
    # Slivers thinner than a pixel of the result may show or not.
    assume(min(left + columns, 100) - max(left, 0) > columns / 48)
    assume(min(top + rows, 80) - max(top, 0) > rows / 64)
    expected, found = (
        crop_and_resize(image, (left, top, columns, rows), 48, 64, max_crop_px).any(axis=2)
        for max_crop_px in (2**22, 0)
    )
    assert found.shape == expected.shape
    for axis in (0, 1):
        assert abs(found.any(axis=axis).sum() - expected.any(axis=axis).sum()) <= 2


def window_of_pixels(left: int, top: int, pixels: int, roll_deg: float = 0.0) -> PersonWindow:
    middle = (pixels - 1) / 2
    return PersonWindow(left + middle, top + middle, float(pixels), roll_deg)


@given(left=st.integers(-40, 130), top=st.integers(-40, 100), pixels=st.integers(1, 64))
def test_window_of_whole_pixels_is_a_crop(left: int, top: int, pixels: int) -> None:
    frame = noise(90, 120)
    expected = padded_crop(frame, left, top, pixels, pixels)
    assert_array_equal(sample_window(frame, window_of_pixels(left, top, pixels), pixels), expected)


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_window_rotated_by_quarter_turns_shows_rotated_pixels(quarter_turns: int) -> None:
    upright, rotated = (
        sample_window(noise(90, 120), window_of_pixels(20, 10, 50, 90.0 * turns), 50)
        for turns in (0, quarter_turns)
    )
    assert_array_equal(rotated, np.rot90(upright, quarter_turns))


@given(window=PERSON_WINDOWS)
def test_windows_of_a_plain_frame_are_plain(window: PersonWindow) -> None:
    """At any size: averaging before sampling neither brightens nor darkens."""
    plain = np.full((90, 120, 3), 200, np.uint8)
    assert sample_window(plain, window, 32).max() <= 200
    margin = window.side / 16 + 2
    corners = window.corners()
    if (corners >= margin).all() and (corners <= [119 - margin, 89 - margin]).all():
        assert (sample_window(plain, window, 32) == 200).all()


@pytest.mark.parametrize("roll_deg", [0.0, 35.0, 180.0])
def test_averaging_shifts_nothing(roll_deg: float) -> None:
    """A slope of brightness stays in place in a window coarser than the frame."""
    rows, columns = np.mgrid[:600, :800]
    frame = np.repeat(((columns + rows) * (250 / 1400))[..., None], 3, axis=2).astype(np.uint8)
    window = PersonWindow(403.3, 296.7, 400.0, roll_deg)
    seen = sample_window(frame, window, 32)[..., 0]
    grid = np.stack(np.meshgrid(np.arange(32.0), np.arange(32.0)), axis=-1)
    x, y = np.moveaxis(transform_points(window.to_frame(32), grid), -1, 0)
    # Grey levels are cut off to whole numbers twice; one is 5.6 pixels.
    assert np.abs(seen + 0.5 - (x + y) * (250 / 1400)).max() < 1.5
