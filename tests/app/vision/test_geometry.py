"""Boxes, alone and in arrays, windows about people, and the pixels of both."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.vision.geometry import (
    Box,
    PersonWindow,
    crop,
    crop_and_resize,
    iou_matrix,
    non_max_suppression,
    sample_window,
    transform_points,
)
from tests.app.vision.conftest import PERSON_WINDOWS

boxes = st.builds(Box, *[st.floats(-50, 50)] * 2, *[st.floats(0.5, 60)] * 2)
box_arrays = st.lists(boxes, min_size=1, max_size=9).map(
    lambda some: np.array([[box.x, box.y, box.width, box.height] for box in some])
)


@given(boxes, boxes)
def test_iou_is_symmetric_and_bounded(a: Box, b: Box) -> None:
    assert 0 <= a.iou(b) <= 1 + 1e-9
    assert a.iou(b) == pytest.approx(b.iou(a))
    assert a.iou(a) == pytest.approx(1)


@pytest.mark.parametrize(
    "make", [Box, lambda *values: PersonWindow(values[0], values[1], values[3], values[2])]
)
@pytest.mark.parametrize("values", [(0, 0, np.inf, 0), (0, 0, 1, -1), (np.nan, 0, 1, 1)])
def test_boxes_and_windows_must_be_finite_and_positive(make: type, values: tuple) -> None:
    with pytest.raises(ValueError, match="positive finite size"):
        make(*values)


@given(box_arrays, box_arrays)
def test_matrix_holds_the_overlap_of_each_pair(first: np.ndarray, second: np.ndarray) -> None:
    pairs = [[(Box(*one), Box(*other)) for other in second] for one in first]
    assert_allclose(iou_matrix(first, second), [[a.iou(b) for a, b in row] for row in pairs],
                    atol=1e-9)  # fmt: skip


@given(boxes=box_arrays, seed=st.integers(0, 999), max_iou=st.floats(0.05, 0.95))
def test_suppression_keeps_boxes_better_than_all_nearby(
    boxes: np.ndarray, seed: int, max_iou: float
) -> None:
    scores = np.random.default_rng(seed).uniform(0, 1, len(boxes))
    kept = non_max_suppression(boxes, scores, max_iou)
    overlaps = iou_matrix(boxes, boxes)
    assert scores[kept[0]] == scores.max()
    assert (np.diff(scores[kept]) <= 0).all()
    for position, row in enumerate(kept):
        assert all(overlaps[row, other] < max_iou for other in kept[:position])
    for row in set(range(len(boxes))) - set(kept):
        assert any(overlaps[row, o] >= max_iou and scores[o] >= scores[row] for o in kept)


@given(window=PERSON_WINDOWS, pixels=st.integers(2, 300))
def test_window_is_scaled_about_its_middle_and_rotated_by_its_roll(
    window: PersonWindow, pixels: int
) -> None:
    middle = np.full(2, (pixels - 1) / 2)
    assert_allclose(
        transform_points(window.to_frame(pixels), middle), [window.x, window.y], atol=1e-9
    )
    linear = window.to_frame(pixels)[:, :2]
    assert_allclose(linear.T @ linear, (window.side / pixels) ** 2 * np.eye(2), atol=1e-6)
    assert np.linalg.det(linear) > 0
    # Up in the window is `roll_deg` clockwise from up in the frame.
    right, down = transform_points(window.to_frame(pixels), middle - [0, 1]) - [window.x, window.y]
    angle = np.rad2deg(np.arctan2(right, -down))
    assert (angle - window.roll_deg + 180) % 360 == pytest.approx(180, abs=1e-6)


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


def window_of_pixels(left: int, top: int, pixels: int, roll_deg: float = 0.0) -> PersonWindow:
    middle = (pixels - 1) / 2
    return PersonWindow(left + middle, top + middle, float(pixels), roll_deg)


@given(left=st.integers(-40, 130), top=st.integers(-40, 100), pixels=st.integers(1, 64))
def test_window_of_whole_pixels_is_a_crop(left: int, top: int, pixels: int) -> None:
    frame = noise(90, 120)
    expected = padded_crop(frame, left, top, pixels, pixels)
    assert_array_equal(sample_window(frame, window_of_pixels(left, top, pixels), pixels), expected)


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
        crop_and_resize(image, (left, top, columns, rows), 48, 64, max_crop_px)[..., 0] > 127
        for max_crop_px in (2**22, 0)
    )
    assert found.shape == expected.shape
    for axis in (0, 1):
        assert abs(found.any(axis=axis).sum() - expected.any(axis=axis).sum()) <= 2
