"""Bodies that are seen whole, and those that the frame or a nearer person cuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.geometry import Box
from app.vision.people import COCO_NAMES, ObservedKeypoints, Silhouette
from app.vision.silhouettes import (
    end_beyond_border,
    hidden_by_others,
    touches_border,
    with_truncation,
)
from tests.support.rotation import rotate_box, rotate_points


def block(left: int, top: int, width: int, height: int) -> Silhouette:
    return Silhouette(np.ones((height, width), bool), left, top, "mask", False)


def keypoints_but(*unseen: str) -> ObservedKeypoints:
    """Keypoints that are seen, except those of some parts."""
    missing = [any(part in name for part in unseen) for name in COCO_NAMES]
    return ObservedKeypoints(np.full((17, 2), 50.0), np.where(missing, 0.05, 0.8))


HEAD, FEET = ("nose", "eye", "ear"), ("ankle",)


def test_silhouette_at_the_border_is_cut() -> None:
    assert touches_border(block(0, 5, 10, 20), (40, 40))
    assert touches_border(block(5, 20, 10, 20), (40, 40))
    assert not touches_border(block(5, 5, 10, 20), (40, 40))


@pytest.mark.parametrize(("left", "top"), [(1, 100), (100, 1), (259, 100), (100, 199)], ids=str)
def test_silhouette_just_short_of_the_edge_is_cut_unless_from_a_mask(left: int, top: int) -> None:
    person = replace(block(left, top, 40, 100), segmenter="network")
    assert touches_border(person, (300, 300))
    assert not touches_border(replace(person, segmenter="mask"), (300, 300))
    inwards = np.clip([left, top], 10, [250, 190]).tolist()
    assert not touches_border(replace(person, left=inwards[0], top=inwards[1]), (300, 300))


@given(left=st.integers(0, 260), top=st.integers(0, 200), name=st.sampled_from(["mask", "network"]))
def test_mirrored_silhouette_is_cut_alike(left: int, top: int, name: str) -> None:
    one = replace(block(left, top, 40, 100), segmenter=name)  # type: ignore[arg-type]
    mirrored = [replace(one, left=260 - left), replace(one, top=200 - top)]
    assert {touches_border(other, (300, 300)) for other in mirrored} == {
        touches_border(one, (300, 300))
    }


def test_unseen_head_or_feet_lie_beyond_the_edge() -> None:
    above, below, inside = (Box(50, y, 40, 100) for y in (3, 198, 100))
    for box, gone in ((above, HEAD), (below, FEET)):
        assert end_beyond_border(box, keypoints_but(*gone), (300, 300))
        assert not end_beyond_border(box, keypoints_but(), (300, 300))
        assert not end_beyond_border(inside, keypoints_but(*gone), (300, 300))


def test_keypoints_beyond_the_edge_are_not_seen() -> None:
    """Whatever their score."""
    keypoints = keypoints_but()
    for i, name in enumerate(COCO_NAMES):
        if name.endswith(FEET):
            keypoints.positions[i, 1] = 310
    assert end_beyond_border(Box(50, 198, 40, 100), keypoints, (300, 300))
    assert not end_beyond_border(Box(50, 198, 40, 100), keypoints, (400, 300))


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
@pytest.mark.parametrize("gone", [HEAD, FEET], ids=["head", "feet"])
def test_rotated_person_ends_at_the_rotated_edge(quarter_turns: int, gone: tuple[str, ...]) -> None:
    shape, keypoints = (300, 400), keypoints_but(*gone)
    for box in (Box(50, 3, 40, 100), Box(50, 198, 40, 100), Box(2, 100, 40, 100)):
        positions = rotate_points(keypoints.positions, shape, -quarter_turns)
        lying = rotate_box(box, shape, -quarter_turns), replace(keypoints, positions=positions)
        its_shape = np.rot90(np.empty(shape), quarter_turns).shape
        assert end_beyond_border(*lying, its_shape) == end_beyond_border(box, keypoints, shape)


def test_nearer_person_hides_the_farther() -> None:
    near, far = block(14, 10, 10, 30), block(5, 5, 12, 30)
    both = with_truncation([near, far], [near.box, far.box], (80, 80))
    assert [one is not None and one.truncated for one in both] == [False, True]
    assert hidden_by_others(far, [near.box])
    assert with_truncation([None], [near.box], (80, 80)) == [None]
