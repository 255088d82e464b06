"""Boxes and silhouettes as values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.people import Box, Detection, Silhouette, silhouette_from_mask
from app.vision.truncation import hidden_by_others, touches_border, with_truncation

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


def test_the_box_of_the_first_pixel() -> None:
    assert Box(-0.5, -0.5, 1, 1).pixels() == (0, 0, 1, 1)
    assert Box(-0.5, -0.5, 1, 1).scaled(2) == Box(-0.5, -0.5, 2, 2)


@pytest.mark.parametrize("bad", [(0, 0, 0, 1), (0, 0, 1, -1), (np.nan, 0, 1, 1), (0, 0, np.inf, 1)])
def test_a_box_without_size_is_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="positive finite size"):
        Box(*bad)


def test_a_score_is_a_probability() -> None:
    with pytest.raises(ValueError, match="0 to 1"):
        Detection(Box(0, 0, 1, 1), 1.5)


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
    assert one.box == Box(1.5, 0.5, 2, 2)
    assert (one.mask(mask.shape) == mask).all()
    assert silhouette_from_mask(mask & False, segmenter="mask", truncated=False) is None
    with pytest.raises(ValueError, match="tight crop"):
        Silhouette(mask, 0, 0, "mask", False)
    with pytest.raises(ValueError, match="dtype bool"):
        Silhouette(mask.astype(np.uint8), 0, 0, "mask", False)


def block(left: int, top: int, width: int, height: int) -> Silhouette:
    return Silhouette(np.ones((height, width), bool), left, top, "mask", False)


def test_a_body_at_the_border_is_cut() -> None:
    assert touches_border(block(0, 5, 10, 20), (40, 40))
    assert touches_border(block(5, 20, 10, 20), (40, 40))
    assert not touches_border(block(5, 5, 10, 20), (40, 40))


def test_one_toe_at_the_border_is_no_cut() -> None:
    crop = np.ones((20, 30), bool)
    crop[-1, 2:] = False
    assert not touches_border(Silhouette(crop, 5, 20, "mask", False), (40, 40))


def test_the_nearer_person_hides_the_farther() -> None:
    near, far = block(14, 10, 10, 30), block(5, 5, 12, 30)
    both = with_truncation([near, far], [near.box, far.box], (80, 80))
    assert [one is not None and one.truncated for one in both] == [False, True]
    assert hidden_by_others(far, [near.box])
    assert with_truncation([None], [near.box], (80, 80)) == [None]
