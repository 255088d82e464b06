"""Windows of an image, and other resolutions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from app.vision import windows as resampling
from app.vision.windows import cut, cut_resized, resize


def picture(height: int, width: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(height + 1000 * width)
    return rng.integers(1, 256, (height, width, 3)).astype(np.uint8)


@given(
    left=st.integers(-30, 60), top=st.integers(-30, 60),
    width=st.integers(1, 70), height=st.integers(1, 70),
)  # fmt: skip
def test_a_window_holds_what_lies_in_it_and_zeros_beyond(
    left: int, top: int, width: int, height: int
) -> None:
    image = picture(30, 40)
    window = cut(image, (left, top, width, height))
    surrounded = np.pad(image, ((100, 200), (100, 200), (0, 0)))
    expected = surrounded[100 + top : 100 + top + height, 100 + left : 100 + left + width]
    assert_array_equal(window, expected)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_shrinking_averages_areas(factor: int) -> None:
    image = picture(30, 60).astype(np.float32)
    blocks = image.reshape(30 // factor, factor, 60 // factor, factor, 3).mean(axis=(1, 3))
    assert np.abs(resize(image, 60 // factor, 30 // factor) - blocks).max() < 1e-3


@given(
    left=st.integers(-12, 12), top=st.integers(-12, 12),
    columns=st.integers(1, 20), rows=st.integers(1, 20),
)  # fmt: skip
def test_large_windows_show_the_same_as_small_ones(
    left: int, top: int, columns: int, rows: int
) -> None:
    """Where whole pixels of the image make one of the result, both ways give the same."""
    image, factor = picture(20, 28), 4
    window = (factor * left, factor * top, factor * columns, factor * rows)
    with pytest.MonkeyPatch.context() as patch:
        expected = cut_resized(image, window, columns, rows)
        patch.setattr(resampling, "_LARGEST_CUT", 0)
        assert_array_equal(cut_resized(image, window, columns, rows), expected)


@given(
    left=st.integers(-500, 90), top=st.integers(-500, 90),
    columns=st.integers(60, 900), rows=st.integers(60, 900),
)  # fmt: skip
def test_in_large_windows_the_image_lies_good_to_a_pixel(
    left: int, top: int, columns: int, rows: int
) -> None:
    image = np.full((80, 100, 3), 255, np.uint8)
    # Slivers thinner than a pixel of the result may show or not.
    assume(min(left + columns, 100) - max(left, 0) > columns / 48)
    assume(min(top + rows, 80) - max(top, 0) > rows / 64)
    expected = resize(cut(image, (left, top, columns, rows)), 48, 64).any(axis=2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resampling, "_LARGEST_CUT", 0)
        found = cut_resized(image, (left, top, columns, rows), 48, 64).any(axis=2)
    assert found.shape == expected.shape
    for axis in (0, 1):
        assert abs(found.any(axis=axis).sum() - expected.any(axis=axis).sum()) <= 2
