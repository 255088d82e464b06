"""Silhouettes by GrabCut, from boxes that are not exact."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.silhouettes import cut_out_by_colour
from scripts.metrics import mask_iou


def upright_shape() -> NDArray[np.float64]:
    """The likely shape of a person: certain in the middle, blurred at its edge."""
    drawn = np.zeros((128, 48))
    cv2.ellipse(drawn, (24, 64), (13, 62), 0, 0, 360, 1, -1)
    return cv2.GaussianBlur(drawn, (0, 0), 5)


SHAPE = upright_shape()


def scene(seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """A person in dark clothes in front of a light wall, and the mask."""
    generator = np.random.default_rng(seed)
    frame = generator.integers(170, 215, (240, 200, 3)).astype(np.uint8)
    mask = np.zeros((240, 200), np.uint8)
    cv2.circle(mask, (100, 52), 12, 1, -1)
    cv2.rectangle(mask, (84, 60), (116, 130), 1, -1)
    cv2.line(mask, (92, 130), (84, 205), 1, 13)
    cv2.line(mask, (108, 130), (116, 205), 1, 13)
    frame[mask > 0] = generator.integers(20, 70, (int(mask.sum()), 3))
    return frame, mask > 0


@pytest.mark.parametrize("off", [(0, 0, 0, 0), (4, -5, 0, 8), (-5, 4, 4, -8)])
def test_a_person_is_cut_out_of_a_box_that_is_not_exact(off: tuple[int, int, int, int]) -> None:
    frame, mask = scene()
    box = Box(75 + off[0], 40 + off[1], 50 + off[2], 172 + off[3])
    (found,) = cut_out_by_colour(frame, [box], SHAPE)
    assert found is not None
    assert found.segmenter == "grabcut"
    assert mask_iou(found.mask(frame.shape), mask) > 0.8


def test_the_same_picture_gets_the_same_silhouette_whatever_came_before() -> None:
    frame, _ = scene()
    boxes = [Box(75, 40, 50, 172)]
    (first,) = cut_out_by_colour(frame, boxes, SHAPE)
    cv2.setRNGSeed(1234)
    cut_out_by_colour(scene(1)[0], boxes, SHAPE)
    (again,) = cut_out_by_colour(frame, boxes, SHAPE)
    assert first is not None and again is not None
    assert np.array_equal(first.crop, again.crop)


@settings(max_examples=30)
@given(
    x=st.floats(-50, 90), y=st.floats(-50, 90), width=st.floats(0.1, 200),
    height=st.floats(0.1, 200), blank=st.booleans(),
)  # fmt: skip
def test_any_box_is_cut_out_or_not(
    x: float, y: float, width: float, height: float, blank: bool
) -> None:
    frame = np.full((90, 60, 3), 127, np.uint8)
    if not blank:
        frame = np.random.default_rng(0).integers(0, 256, frame.shape).astype(np.uint8)
    (found,) = cut_out_by_colour(frame, [Box(x, y, width, height)], SHAPE)
    assert found is None or found.mask(frame.shape).any()


def test_people_side_by_side_share_no_pixel() -> None:
    frame, _ = scene()
    frame = np.hstack([frame, frame])
    boxes = [Box(75, 40, 90, 172), Box(235, 40, 90, 172)]
    first, second = cut_out_by_colour(frame, boxes, SHAPE)
    assert first is not None and second is not None
    assert not (first.mask(frame.shape) & second.mask(frame.shape)).any()
