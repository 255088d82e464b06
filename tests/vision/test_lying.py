"""People who lie: wide presence, and joints with one end up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.joints import JointReader
from app.vision.lying import (
    MOST,
    find_lying,
    is_wide,
    lying_parts,
    seen_upright,
    segment_either_way,
    segment_people,
    which_way_up,
)
from app.vision.networks import Networks, PersonNetwork
from app.vision.people import Box, Detection
from app.vision.people_detector import make_detector
from app.vision.presence import Presence, PresenceMap
from app.vision.segment import NetworkSegmenter
from app.vision.turning import turned_box, turned_silhouette

SHAPE = (200, 300)


def presence_of(boxes: Sequence[tuple[int, int, int, int]], factor: float = 1.0) -> Presence:
    """Presence that fills boxes of left, top, width and height."""
    probability = np.zeros(SHAPE, np.float32)
    for left, top, width, height in boxes:
        probability[top : top + height, left : left + width] = 0.95
    return Presence([PresenceMap(probability, 200.0)], factor, 50.0)


@pytest.fixture(scope="module")
def reader() -> JointReader:
    return JointReader()


def test_what_is_wide_and_in_one_piece_may_lie() -> None:
    (part,) = lying_parts(presence_of([(20, 30, 120, 40), (200, 20, 40, 120)]), [], SHAPE)
    assert part.box == Box(19.5, 29.5, 120, 40)
    assert part.crop.all()


def test_pixels_are_those_of_the_whole_frame() -> None:
    (part,) = lying_parts(presence_of([(20, 30, 120, 40)], factor=0.5), [], (400, 600))
    assert part.box == Box(39.5, 59.5, 240, 80)


@pytest.mark.parametrize("shape", [(601, 901), (599, 899), (600, 900)])
def test_what_reaches_the_borders_stays_within_the_frame(shape: tuple[int, int]) -> None:
    # A resized frame is rounded to whole pixels.
    presence = presence_of([(100, 130, 200, 70)], factor=1 / 3)
    (part,) = lying_parts(presence, [], shape)
    for turns in (1, 3):
        turned = turned_silhouette(part, shape, turns)
        assert (turned.mask(shape[::-1]) == np.rot90(part.mask(shape), turns)).all()


@pytest.mark.parametrize(
    "box", [(20, 30, 30, 10), (20, 30, 60, 55), (20, 30, 150, 20), (10, 30, 250, 100)]
)
def test_too_small_too_square_too_long_and_too_large_is_nobody(
    box: tuple[int, int, int, int],
) -> None:
    assert lying_parts(presence_of([box]), [], SHAPE) == []


def test_people_who_are_found_are_not_found_again() -> None:
    presence = presence_of([(20, 30, 120, 40)])
    assert lying_parts(presence, [Box(10, 20, 140, 60)], SHAPE) == []
    assert len(lying_parts(presence, [Box(10, 20, 30, 60)], SHAPE)) == 1


def test_few_are_searched() -> None:
    rows = [(20 + 140 * (i % 2), 5 + 50 * (i // 2), 100, 35) for i in range(6)]
    assert len(lying_parts(presence_of(rows), [], SHAPE)) == MOST


def test_nothing_is_nobody(network: PersonNetwork, reader: JointReader) -> None:
    frame = np.full((*SHAPE, 3), 127, np.uint8)
    assert lying_parts(presence_of([]), [], SHAPE) == []
    mistaken = presence_of([(20, 30, 120, 40)])
    assert seen_upright(network, frame, lying_parts(mistaken, [], SHAPE)) == []
    assert find_lying(network, reader, frame, mistaken, [], 0.0) == []


@pytest.mark.parametrize("turns", [1, 3])
def test_a_walker_in_a_turned_frame_lies(
    turns: int,
    network: PersonNetwork,
    segmenter: NetworkSegmenter,
    reader: JointReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
) -> None:
    part = street[120:290, 100:200]
    walker = Box(walkers[1].x - 100, walkers[1].y - 120, walkers[1].width, walkers[1].height)
    lying = np.ascontiguousarray(np.rot90(part, turns))
    truth = turned_box(walker, part.shape, turns)
    (upright,) = segmenter.segment(part, [walker])
    found = segment_people(segmenter, lying, [Detection(truth, 0.9, (-turns) % 4)])
    assert upright is not None and found[0] is not None
    expected = np.rot90(upright.mask(part.shape), turns)
    both = expected & found[0].mask(lying.shape)
    assert both.sum() > 0.9 * expected.sum()
    assert which_way_up(reader, lying, found[0])[1] == (-turns) % 4


def test_somebody_who_lies_is_detected(
    networks: Networks,
    segmenter: NetworkSegmenter,
    reader: JointReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
) -> None:
    detector = make_detector(networks, segmenter, reader)
    lying = np.ascontiguousarray(np.rot90(street, 1))
    found = [one for one in detector.detect(lying) if one.turns]
    assert found, "expected somebody who lies, found nobody"
    truths = [turned_box(one, street.shape, 1) for one in walkers]
    assert all(one.turns == 3 for one in found)
    assert all(max(one.box.iou(truth) for truth in truths) > 0.5 for one in found)
    assert not any(one.turns for one in detector.detect(street))


@pytest.mark.parametrize("turns", [0, 1, 3])
def test_a_wide_box_is_looked_at_either_way(
    turns: int,
    segmenter: NetworkSegmenter,
    reader: JointReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
) -> None:
    frame = np.ascontiguousarray(np.rot90(street, -turns))
    box = turned_box(walkers[1], street.shape, -turns)
    (upright,) = segmenter.segment(frame, [box])
    assert upright is not None
    silhouette, told = segment_either_way(segmenter, reader, frame, box, upright)
    assert told == turns
    assert silhouette.box.iou(box) > 0.7
    assert which_way_up(reader, frame, silhouette)[1] == turns
    assert is_wide(box) == (turns != 0)
