"""Silhouettes: from labels, and by the network."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.decoding.decode import LabelImage
from app.vision.people import Box, Silhouette
from app.vision.resampling import Window
from app.vision.segmentation.body_network import COLUMNS, ROWS, BodyNetwork
from app.vision.segmentation.segment import NetworkSegmenter, silhouettes_from_labels


def mask_of(one: Silhouette | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    assert one is not None
    return one.mask(shape)


def iou(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> float:
    return float((first & second).sum() / (first | second).sum())


class PaintedNetwork(BodyNetwork):
    """Says of windows what was painted: who is in the middle of a window has an ellipse.

    Parameters
    ----------
    boxes : list of Box
        Of everybody.
    peaks : list of float
        How sure it is of each in the middle of their box; less towards its border.
    """

    def __init__(self, boxes: list[Box], peaks: list[float]) -> None:
        self._people = list(zip(boxes, peaks, strict=True))

    def probability(self, frame: NDArray[np.uint8], window: Window) -> NDArray[np.float32]:
        left, top, width, height = window
        y, x = np.mgrid[:ROWS, :COLUMNS] + 0.5
        x, y = left - 0.5 + x * width / COLUMNS, top - 0.5 + y * height / ROWS
        middle = left - 0.5 + width / 2
        box, peak = min(self._people, key=lambda p: abs(p[0].x + p[0].width / 2 - middle))
        across = 2 * (x - box.x - box.width / 2) / box.width
        down = 2 * (y - box.y - box.height / 2) / box.height
        return (peak * np.clip(1.3 - across**2 - down**2, 0, 1)).astype(np.float32)


FRAME = np.zeros((240, 320, 3), np.uint8)


def painted(boxes: list[Box], *peaks: float) -> list[Silhouette | None]:
    return NetworkSegmenter(PaintedNetwork(boxes, list(peaks))).segment(FRAME, boxes)


def test_labels_become_silhouettes_from_left_to_right() -> None:
    labels = np.zeros((20, 30), np.uint16)
    labels[3:9, 20:25] = 1
    labels[2:9, 3:8] = 7
    people = silhouettes_from_labels(LabelImage.of(labels))
    assert [one.left for one in people] == [3, 20]
    assert [one.segmenter for one in people] == ["mask", "mask"]
    assert silhouettes_from_labels(LabelImage.of(labels * 0)) == []


@given(
    width=st.integers(20, 120), height=st.integers(40, 200), x=st.integers(10, 150),
    y=st.integers(5, 30),
)  # fmt: skip
def test_what_the_network_marks_is_cut_out_where_it_is(
    width: int, height: int, x: int, y: int
) -> None:
    box = Box(x - 0.5, y - 0.5, width, height)
    found = mask_of(painted([box], 0.9)[0], FRAME.shape)
    rows, columns = np.mgrid[: FRAME.shape[0], : FRAME.shape[1]]
    across = 2 * (columns - box.x - box.width / 2) / box.width
    down = 2 * (rows - box.y - box.height / 2) / box.height
    expected = 0.9 * (1.3 - across**2 - down**2) >= 0.5
    # The network's pixels are up to 1.5 of the frame's: half of one along the outline.
    outline = 2 * (width + height)
    assert np.count_nonzero(found ^ expected) <= 0.5 * outline


def test_a_pixel_that_two_claim_is_the_surer_ones() -> None:
    left, right = Box(49.5, 29.5, 80, 180), Box(99.5, 29.5, 80, 180)
    alike = [mask_of(one, FRAME.shape) for one in painted([left, right], 0.9, 0.9)]
    # Between equals the border is in the middle, and each pixel is one person's.
    seam = np.s_[119, 99:130]
    assert not (alike[0] & alike[1]).any(axis=0)[[105, 122]].any()
    assert alike[0][seam].sum() == pytest.approx(alike[1][seam].sum(), abs=2)
    surer, other = (mask_of(one, FRAME.shape) for one in painted([left, right], 0.95, 0.6))
    assert surer.sum() > alike[0].sum()
    assert other.sum() < alike[1].sum()
    assert np.count_nonzero(surer & other) <= 0.02 * surer.sum()


@pytest.mark.parametrize(("short_px", "is_cut"), [(0, True), (5, True), (7, False)])
@pytest.mark.parametrize("edge", ["left", "top", "right", "bottom"])
def test_boxes_that_end_just_short_of_the_frames_edge_do_not_end_the_silhouette(
    edge: str, short_px: int, is_cut: bool
) -> None:
    height, width = FRAME.shape[:2]
    body, visible = {
        "left": (Box(-50.5, 19.5, 140, 200), Box(short_px - 0.5, 19.5, 90 - short_px, 200)),
        "top": (Box(99.5, -60.5, 90, 200), Box(99.5, short_px - 0.5, 90, 140 - short_px)),
        "right": (Box(width - 90.5, 19.5, 140, 200), Box(width - 90.5, 19.5, 90 - short_px, 200)),
        "bottom": (
            Box(99.5, height - 140.5, 90, 200),
            Box(99.5, height - 140.5, 90, 140 - short_px),
        ),
    }[edge]
    (found,) = NetworkSegmenter(PaintedNetwork([body], [0.9])).segment(FRAME, [visible])
    mask = mask_of(found, FRAME.shape)
    border = {"left": mask[:, 0], "top": mask[0], "right": mask[:, -1], "bottom": mask[-1]}[edge]
    assert border.any() == is_cut
    assert found is not None and found.truncated == is_cut


def test_people_apart_are_cut_out_as_if_alone() -> None:
    left, right = Box(19.5, 29.5, 80, 180), Box(179.5, 29.5, 80, 180)
    both = painted([left, right], 0.6, 0.95)
    alone = painted([left], 0.6)
    assert (mask_of(both[0], FRAME.shape) == mask_of(alone[0], FRAME.shape)).all()


def test_where_the_network_sees_nobody_there_is_no_silhouette() -> None:
    boxes = [Box(19.5, 29.5, 80, 180), Box(179.5, 29.5, 80, 180)]
    found = painted(boxes, 0.1, 0.9)
    assert found[0] is None and found[1] is not None


ODD_BOXES = [
    Box(-30, -20, 50, 60),
    Box(5, 5, 1, 1),
    Box(200, 200, 10, 10),
    Box(0, 0, 300, 2),
    Box(-0.5, -0.5, 298, 320),
]


@pytest.mark.parametrize("shape", [(320, 298, 3), (1, 1, 3), (3, 900, 3)])
def test_odd_boxes_and_blank_walls_are_survived(
    segmenter: NetworkSegmenter, shape: tuple[int, ...]
) -> None:
    blank = np.full(shape, 127, np.uint8)
    found = segmenter.segment(blank, ODD_BOXES)
    assert len(found) == len(ODD_BOXES)
    assert segmenter.segment(blank, []) == []


@given(
    x=st.floats(-60, 380), y=st.floats(-60, 300), width=st.floats(0.01, 400),
    height=st.floats(0.01, 300),
)  # fmt: skip
@example(x=0.0, y=239.0, width=2.0, height=2.0)
@example(x=319.0, y=0.0, width=2.0, height=2.0)
def test_silhouettes_lie_in_the_frame_whatever_the_box(
    x: float, y: float, width: float, height: float
) -> None:
    for one in painted([Box(x, y, width, height)], 0.9):
        if one is not None:
            rows, columns = one.crop.shape
            assert one.left + columns <= FRAME.shape[1]
            assert one.top + rows <= FRAME.shape[0]


def test_walkers_are_cut_out(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    for one, box in zip(segmenter.segment(street, walkers), walkers, strict=True):
        assert one is not None and one.segmenter == "network" and not one.truncated
        assert one.box.iou(box) > 0.7
        assert 0.25 < one.area_px / box.area < 0.75


def test_walkers_in_a_mirrored_street_have_mirrored_silhouettes(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    width = street.shape[1]
    mirrored = [Box(width - 1 - b.right, b.y, b.width, b.height) for b in walkers]
    there = segmenter.segment(np.ascontiguousarray(street[:, ::-1]), mirrored)
    for one, other in zip(segmenter.segment(street, walkers), there, strict=True):
        assert iou(mask_of(one, street.shape), mask_of(other, street.shape)[:, ::-1]) > 0.85


@pytest.mark.parametrize("factor", [2, 5])
def test_a_larger_frame_has_the_same_silhouettes(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box], factor: int
) -> None:
    """Five times as large, a walker is drawn at less than the frame's resolution."""
    large = cv2.resize(street, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    found = segmenter.segment(large, [box.scaled(factor) for box in walkers])
    for one, other in zip(segmenter.segment(street, walkers), found, strict=True):
        small = mask_of(one, street.shape)
        same = np.kron(small, np.ones((factor, factor), bool))
        assert iou(same, mask_of(other, large.shape)) > 0.85


def test_a_walker_cut_by_the_frame_is_flagged(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    frame = street[:215]
    one = segmenter.segment(frame, [walkers[1]])[0]
    assert one is not None and one.truncated


def test_threads_agree(
    segmenter: NetworkSegmenter, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    expected = segmenter.segment(street, walkers)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: segmenter.segment(street, walkers), range(12)):
            for one, other in zip(found, expected, strict=True):
                assert (mask_of(one, street.shape) == mask_of(other, street.shape)).all()
