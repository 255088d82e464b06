"""Boxes of the data sets: rotated with their frames."""

from __future__ import annotations

import numpy as np
import pytest

from app.vision.geometry import Box
from scripts.datasets import rotate_box
from tests.support.rotation import rotate_box as rotate_corners

SHAPE = (30, 50, 3)


@pytest.mark.parametrize("quarter_turns", [-3, -1, 0, 1, 2, 3])
def test_boxes_turn_with_their_frame_and_back(quarter_turns: int) -> None:
    turned = np.rot90(np.empty(SHAPE[:2]), quarter_turns).shape
    box = Box(3.5, 4.25, 20, 7)
    there = rotate_box(box, SHAPE, quarter_turns)
    assert there == rotate_corners(box, SHAPE, quarter_turns)
    assert rotate_box(there, turned, -quarter_turns) == box
