"""BlazePose's detector and landmark network, however the frame is rotated."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.blazepose import (
    ANCHOR_GRIDS,
    DETECTOR_PX,
    LANDMARK_PX,
    BlazePoseDetector,
    LandmarkNetwork,
    MaskNetwork,
    decode_anchors,
    sample_map,
)
from app.vision.geometry import Box, PersonWindow, transform_points
from app.vision.people import LANDMARK_NAMES
from tests.support.rotation import rotate_points

LIMBS = [
    row
    for row, name in enumerate(LANDMARK_NAMES)
    if name.endswith(("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
]
WALKER = pytest.mark.parametrize("number", range(3))


@WALKER
def test_landmarks_and_mask_are_the_walkers(
    landmark_network: LandmarkNetwork,
    mask_network: MaskNetwork,
    street: NDArray[np.uint8],
    walkers: list[Box],
    number: int,
) -> None:
    box = walkers[number]
    reading = mask_network.read(landmark_network.read(street, PersonWindow.about_box(box)))
    assert reading.presence > 0.9
    landmarks = reading.landmarks
    assert ((landmarks.visibility >= 0) & (landmarks.visibility <= 1)).all()
    margin = 0.08 * box.height
    assert (landmarks.positions > [box.x - margin, box.y - margin]).all()
    assert (landmarks.positions < [box.right + margin, box.bottom + margin]).all()
    # From ear to ankle, in pixels and in metres.
    names = [[f"{side}_{part}" for side in ("left", "right")]
             for part in ("ear", "shoulder", "hip", "knee", "ankle")]  # fmt: skip
    rows = [[LANDMARK_NAMES.index(name) for name in pair] for pair in names]
    assert (np.diff(landmarks.positions[rows, 1].mean(axis=1)) > 0).all()
    heights = landmarks.metres[:, 1]
    assert heights[LANDMARK_NAMES.index("nose")] < -0.3 < 0.3 < heights[-1]
    assert reading.probability is not None
    assert reading.probability.shape == (LANDMARK_PX, LANDMARK_PX)
    assert reading.probability.min() >= 0 and reading.probability.max() <= 1
    y, x = np.nonzero(reading.probability > 0.5)
    to_frame = reading.window.to_frame(LANDMARK_PX)
    x, y = transform_points(to_frame, np.stack([x, y], axis=1)).T
    inside = (x > box.x - 2) & (x < box.right + 2) & (y > box.y - 2) & (y < box.bottom + 2)
    assert inside.mean() > 0.95
    area = len(x) * (reading.window.side / LANDMARK_PX) ** 2
    assert 0.25 < area / box.area < 0.75


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
@WALKER
def test_landmarks_rotate_with_the_street(
    landmark_network: LandmarkNetwork,
    street: NDArray[np.uint8],
    walkers: list[Box],
    number: int,
    quarter_turns: int,
) -> None:
    window = PersonWindow.about_box(walkers[number])
    here = landmark_network.read(street, window)
    x, y = rotate_points(np.array([window.x, window.y]), street.shape, quarter_turns).tolist()
    there = landmark_network.read(
        np.ascontiguousarray(np.rot90(street, quarter_turns)),
        PersonWindow(x, y, window.side, -90.0 * quarter_turns),
    )
    positions = rotate_points(here.landmarks.positions, street.shape, quarter_turns)
    metres = here.landmarks.metres.copy()
    metres[:, :2] = rotate_points(metres[:, :2], (1, 1), quarter_turns)
    for found, expected, height in (
        (there.landmarks.positions, positions, walkers[number].height),
        (there.landmarks.metres, metres, 1.7),
    ):
        assert np.linalg.norm((found - expected)[LIMBS], axis=-1).mean() < 0.02 * height
    assert there.drift == pytest.approx(here.drift, abs=0.05)


def test_windows_without_a_person_have_a_low_presence(
    landmark_network: LandmarkNetwork, street: NDArray[np.uint8]
) -> None:
    blank = np.full((50, 400, 3), 127, np.uint8)
    asphalt, grass = Box(100, 200, 30, 80), Box(60, 30, 30, 80)
    for frame, window in (
        *((street, PersonWindow.about_box(box)) for box in (asphalt, grass)),
        *((blank, window) for window in (PersonWindow(-900, 30, 5), PersonWindow(200, 25, 1e-3),
                                         PersonWindow(0, 0, 1e5))),
    ):  # fmt: skip
        reading = landmark_network.read(frame, window)
        assert reading.presence < 0.5
        assert np.isfinite(reading.landmarks.positions).all()


@given(seed=st.integers(0, 9999), count=st.integers(0, 12))
def test_anchors_are_decoded_like_one_by_one(seed: int, count: int) -> None:
    centres = [
        ((column + 0.5) * stride, (row + 0.5) * stride)
        for stride, per_cell in ANCHOR_GRIDS
        for row in range(DETECTOR_PX // stride)
        for column in range(DETECTOR_PX // stride)
        for _ in range(per_cell)
    ]
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 50, (len(centres), 12)).astype(np.float32)
    used = rng.choice(len(centres), count, replace=False)
    boxes, points = decode_anchors(values, used)
    assert boxes.shape == (count, 4) and points.shape == (count, 4, 2)
    for box, four, anchor in zip(boxes, points, used, strict=True):
        x, y = centres[anchor]
        dx, dy, width, height, *offsets = values[anchor].astype(float).tolist()
        assert_allclose(box, [x + dx - width / 2, y + dy - height / 2, width, height])
        assert_allclose(four, np.add([x, y], np.reshape(offsets, (4, 2))))


@pytest.fixture(scope="module")
def large_walker(street: NDArray[np.uint8], walkers: list[Box]) -> NDArray[np.uint8]:
    """A walker who fills much of a frame of 300x300."""
    box = walkers[2]
    left, top = round(box.x + box.width / 2) - 75, round(box.y) - 30
    part = street[top : top + 150, left : left + 150]
    return np.ascontiguousarray(np.kron(part, np.ones((2, 2, 1), np.uint8)))


@pytest.mark.parametrize("quarter_turns", range(4))
def test_body_is_detected_in_any_orientation(
    body_detector: BlazePoseDetector, large_walker: NDArray[np.uint8], quarter_turns: int
) -> None:
    here = body_detector.detect(large_walker, 0.3)[0].window
    rotated = np.ascontiguousarray(np.rot90(large_walker, quarter_turns))
    there = body_detector.detect(rotated, 0.3)[0].window
    expected = rotate_points(np.array([here.x, here.y]), large_walker.shape, quarter_turns)
    assert np.hypot(*(expected - [there.x, there.y])) < 0.08 * here.side
    assert there.side == pytest.approx(here.side, rel=0.2)
    # Counterclockwise quarter turns.
    off = there.roll_deg - here.roll_deg + 90 * quarter_turns
    assert abs((off + 180) % 360 - 180) < 20


@pytest.mark.parametrize("size", [(300, 300), (900, 900), (300, 500), (450, 300)])
def test_body_is_in_the_same_place_in_a_frame_of_any_size(
    body_detector: BlazePoseDetector, large_walker: NDArray[np.uint8], size: tuple[int, int]
) -> None:
    """Larger, or with black on the right or below."""
    factor = max(1, min(size) // 300)
    large = cv2.resize(large_walker, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    frame = np.zeros((*size, 3), np.uint8)
    frame[: large.shape[0], : large.shape[1]] = large
    here = body_detector.detect(large_walker, 0.3)[0].window
    there = body_detector.detect(frame, 0.3)[0].window
    expected = factor * (np.array([here.x, here.y]) + 0.5) - 0.5
    assert np.hypot(*(expected - [there.x, there.y])) < 0.08 * factor * here.side


def test_bodies_come_best_first_down_to_the_minimum(
    body_detector: BlazePoseDetector, large_walker: NDArray[np.uint8]
) -> None:
    every, sure = (
        [body.score for body in body_detector.detect(large_walker, least)] for least in (0.01, 0.3)
    )
    assert every == sorted(every, reverse=True)
    assert sure == [score for score in every if score >= 0.3]


def test_maps_are_seen_in_the_middle_of_their_cells() -> None:
    maps = np.random.default_rng(0).normal(size=(2, 8, 8, 3)).astype(np.float32)
    points = np.zeros((2, 39, 5), np.float32)
    points[:, :33, 0], points[:, :33, 1] = 32 * 5 + 16, 32 * 2 + 16
    assert_allclose(sample_map(maps, points), np.repeat(maps[:, None, 2, 5], 33, 1), atol=1e-6)
    points[:, :33, :2] = [-500, 9999]
    assert_allclose(sample_map(maps, points), np.repeat(maps[:, None, 7, 0], 33, 1), atol=1e-6)
