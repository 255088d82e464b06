"""HOG: the search of a frame over many scales, and the margin of a box."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.detectors.hog import HogDetector, hog_margin
from app.vision.detectors.tiles import Picture
from app.vision.geometry import Box, resize
from app.vision.people import Detection

EMPTY = [Box(100, 200, 30, 80), Box(20, 200, 40, 100), Box(60, 30, 30, 80)]
"""Asphalt and grass of `street`."""


def test_people_have_higher_margins_than_asphalt(
    street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    people = [hog_margin(street, box) for box in (*walkers, *far_walkers)]
    empty = [hog_margin(street, box) for box in EMPTY]
    assert min(people) > max(empty) + 1
    assert min(people[:3]) > 0 > max(empty)


def detected(frame: NDArray[np.uint8], min_person_px: float | None = None) -> list[Detection]:
    return HogDetector(min_person_px).detect(Picture(frame, ()))


@pytest.mark.parametrize("factor", [1, 1.7, 2.6])
def test_walkers_are_found_at_any_size(
    street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box], factor: float
) -> None:
    frame = resize(street, round(factor * street.shape[1]), round(factor * street.shape[0]))
    found = [one.box for one in detected(frame)]
    for walker in (*walkers, *far_walkers):
        assert max(walker.scaled(factor).iou(box) for box in found) > 0.5


@settings(max_examples=5)
@given(width=st.integers(1, 200), height=st.integers(1, 200), seed=st.integers(0, 99))
def test_any_frame_may_be_searched(width: int, height: int, seed: int) -> None:
    frame = np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)
    for one in detected(frame):
        assert one.box.x >= -0.5
        assert one.box.right <= width - 0.5
