"""Boxes and silhouettes as values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.geometry import (
    COCO_NAMES,
    LANDMARK_NAMES,
    Box,
    Detection,
    Landmarks,
    ObservedKeypoints,
    PersonWindow,
    Silhouette,
    silhouette_from_mask,
)

numbers = st.floats(-50, 50)
sizes = st.floats(0.5, 60)
boxes = st.builds(Box, numbers, numbers, sizes, sizes)


def parse(drawing: str) -> np.ndarray:
    return np.array([[c == "#" for c in line.strip()] for line in drawing.strip().splitlines()])


@given(boxes, boxes)
def test_iou_is_symmetric_and_bounded(a: Box, b: Box) -> None:
    assert 0 <= a.iou(b) <= 1 + 1e-9
    assert a.iou(b) == pytest.approx(b.iou(a))
    assert a.iou(a) == pytest.approx(1)


@given(boxes)
def test_clipping_stays_inside_and_is_idempotent(box: Box) -> None:
    clipped = box.clip(40, 30)
    if clipped is None:
        assert Box(-0.5, -0.5, 40, 30).intersection(box) == 0
    else:
        assert clipped.x >= -0.5 and clipped.right <= 39.5 + 1e-9 and clipped.bottom <= 29.5 + 1e-9
        assert clipped.area <= box.area + 1e-6


@given(boxes, st.floats(0.2, 5))
def test_scaling_there_and_back(box: Box, factor: float) -> None:
    again = box.scaled(factor).scaled(1 / factor)
    assert (again.x, again.y, again.width) == pytest.approx((box.x, box.y, box.width), abs=1e-6)


def test_a_silhouette_is_a_tight_crop() -> None:
    mask = parse("""
        ......
        ..##..
        ..#...
        ......
    """)
    one = silhouette_from_mask(mask, segmenter="mask", truncated=False)
    assert one is not None
    assert (one.left, one.top, one.area_px) == (2, 1, 3)
    rows, columns = np.nonzero(one.crop)
    np.testing.assert_allclose(one.centroid, [columns.mean() + 2, rows.mean() + 1])
    assert one.box == Box(1.5, 0.5, 2, 2)
    assert (one.mask(mask.shape) == mask).all()
    assert silhouette_from_mask(mask & False, segmenter="mask", truncated=False) is None
    with pytest.raises(ValueError, match="tight crop"):
        Silhouette(mask, 0, 0, "mask", False)
    with pytest.raises(ValueError, match="dtype bool"):
        Silhouette(mask.astype(np.uint8), 0, 0, "mask", False)


@given(factor=st.floats(0.1, 9), x=numbers, y=numbers)
def test_keypoints_follow_a_box_wherever_it_goes(factor: float, x: float, y: float) -> None:
    """A keypoint in a corner of a box stays there."""
    box = Box(x, y, 20, 30)
    corner = ObservedKeypoints(np.tile([box.right, box.y], (17, 1)), np.ones(17))
    moved = corner.scaled(factor).moved(x, y)
    scaled = box.scaled(factor)
    assert moved.positions[3] == pytest.approx([scaled.right + x, scaled.y + y], abs=1e-6)
    again = moved.moved(-x, -y).scaled(1 / factor)
    assert again.positions == pytest.approx(corner.positions, abs=1e-6)
    assert again.scores is corner.scores


def test_the_keypoints_among_landmarks_have_their_names() -> None:
    positions = np.stack([np.arange(33.0), np.zeros(33)], axis=1)
    found = Landmarks(positions, np.arange(33) / 33, np.zeros((33, 3))).keypoints()
    rows = found.positions[:, 0].astype(int)
    assert tuple(LANDMARK_NAMES[row] for row in rows) == COCO_NAMES
    assert found.scores == pytest.approx(rows / 33)


@pytest.mark.parametrize(
    ("make", "arguments", "said"),
    [
        *((Box, bad, "positive finite size")
          for bad in ((0, 0, 0, 1), (0, 0, 1, -1), (np.nan, 0, 1, 1), (0, 0, np.inf, 1))),
        *((PersonWindow, bad, "positive finite size")
          for bad in ((0, 0, 0, 0), (0, 0, -1, 0), (np.nan, 0, 1, 0), (0, 0, 1, np.inf))),
        (Detection, (Box(0, 0, 1, 1), 1.5), "0 to 1"),
        *((ObservedKeypoints, (np.zeros((rows, 2)), np.zeros(scores)), "positions of shape")
          for rows, scores in ((16, 17), (17, 16), (0, 0))),
        *((Landmarks, (np.zeros((rows, 2)), np.zeros(scores), np.zeros((depths, 3))),
           "expected arrays of shapes")
          for rows, scores, depths in ((32, 33, 33), (33, 32, 33), (33, 33, 32))),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(make: type, arguments: tuple[Any, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make(*arguments)
