"""BlazePose's detector: anchors decoded as one by one, bodies where they are however turned."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.detection.pose_detection import CELLS, PIXELS, PoseDetection, decode
from app.vision.people import Box
from tests.support.rotation import rotate_points


def anchors() -> list[tuple[float, float]]:
    """Centres of the anchors, row by row of each grid."""
    centres = []
    for stride, count in CELLS:
        for row in range(PIXELS // stride):
            for column in range(PIXELS // stride):
                centres += [((column + 0.5) * stride, (row + 0.5) * stride)] * count
    return centres


@given(seed=st.integers(0, 9999), count=st.integers(0, 12))
def test_anchors_are_decoded_as_one_by_one(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    centres = anchors()
    values = rng.normal(0, 50, (len(centres), 12)).astype(np.float32)
    used = rng.choice(len(centres), count, replace=False)
    boxes, points = decode(values, used)
    assert boxes.shape == (count, 4) and points.shape == (count, 4, 2)
    for box, four, anchor in zip(boxes, points, used, strict=True):
        x, y = centres[anchor]
        dx, dy, width, height, *offsets = values[anchor].astype(float).tolist()
        assert_allclose(box, [x + dx - width / 2, y + dy - height / 2, width, height])
        for number, point in enumerate(four):
            assert_allclose(point, [x + offsets[2 * number], y + offsets[2 * number + 1]])


@pytest.fixture(scope="module")
def large_walker(street: NDArray[np.uint8], walkers: list[Box]) -> NDArray[np.uint8]:
    """A walker who fills much of a frame of 300x300."""
    box = walkers[2]
    left, top = round(box.x + box.width / 2) - 75, round(box.y) - 30
    cut = street[top : top + 150, left : left + 150]
    return np.ascontiguousarray(np.kron(cut, np.ones((2, 2, 1), np.uint8)))


@pytest.mark.parametrize("quarter_turns", range(4))
def test_a_body_is_found_whichever_way_it_is_turned(
    pose_detection: PoseDetection, large_walker: NDArray[np.uint8], quarter_turns: int
) -> None:
    here = pose_detection.bodies(large_walker, 0.3)[0].window
    turned = np.ascontiguousarray(np.rot90(large_walker, quarter_turns))
    there = pose_detection.bodies(turned, 0.3)[0].window
    expected = rotate_points(np.array([here.x, here.y]), large_walker.shape, quarter_turns)
    assert np.hypot(*(expected - [there.x, there.y])) < 0.08 * here.side
    assert there.side == pytest.approx(here.side, rel=0.2)
    # Counterclockwise quarter turns.
    off = there.roll_deg - here.roll_deg + 90 * quarter_turns
    assert abs((off + 180) % 360 - 180) < 20


@pytest.mark.parametrize("size", [(300, 300), (900, 900), (300, 500), (450, 300)])
def test_where_a_body_is_does_not_depend_on_the_frames_size(
    pose_detection: PoseDetection, large_walker: NDArray[np.uint8], size: tuple[int, int]
) -> None:
    """Larger, or with black on the right or below: the same body in the same place."""
    factor = max(1, min(size) // 300)
    large = cv2.resize(large_walker, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    frame = np.zeros((*size, 3), np.uint8)
    frame[: large.shape[0], : large.shape[1]] = large
    here = pose_detection.bodies(large_walker, 0.3)[0].window
    there = pose_detection.bodies(frame, 0.3)[0].window
    expected = factor * (np.array([here.x, here.y]) + 0.5) - 0.5
    assert np.hypot(*(expected - [there.x, there.y])) < 0.08 * factor * here.side


def test_bodies_are_as_sure_as_asked_and_best_first(
    pose_detection: PoseDetection, large_walker: NDArray[np.uint8]
) -> None:
    found = [body.score for body in pose_detection.bodies(large_walker, 0.01)]
    assert found == sorted(found, reverse=True)
    assert [b.score for b in pose_detection.bodies(large_walker, 0.3)] == [
        score for score in found if score >= 0.3
    ]
