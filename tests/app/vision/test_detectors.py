"""Detectors: what they see of a frame, and bodies in any orientation."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.detectors.blazepose import (
    ANCHOR_GRIDS,
    DETECTOR_PX,
    BlazePoseDetector,
    decode_anchors,
)
from app.vision.detectors.tiles import (
    MAX_FINE_PX,
    MAX_FINE_SIDE_PX,
    MAX_TILE_PX,
    MIN_GAIN,
    MIN_PERSON_PX,
    MIN_SIDE_PX,
    OVERVIEW_PX,
    Picture,
    Tile,
    tiles_of,
)
from app.vision.geometry import Box
from app.vision.people import Detection
from tests.support.rotation import rotate_points


def bodies(detector: BlazePoseDetector, frame: NDArray[np.uint8]) -> list[Detection]:
    return detector.detect(Picture.of(frame, None))


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
    here = bodies(body_detector, large_walker)[0].windows[0]
    rotated = np.ascontiguousarray(np.rot90(large_walker, quarter_turns))
    there = bodies(body_detector, rotated)[0].windows[0]
    expected = rotate_points(np.array([here.x, here.y]), large_walker.shape, quarter_turns)
    assert np.hypot(*(expected - [there.x, there.y])) < 0.08 * here.side
    assert there.side == pytest.approx(here.side, rel=0.2)
    # Counterclockwise quarter turns.
    off = there.roll_deg - here.roll_deg + 90 * quarter_turns
    assert abs((off + 180) % 360 - 180) < 20


people = st.integers(16, 400)
sides = st.integers(1, 6000)


@given(width=sides, height=sides, min_person_px=people)
def test_tiles_cover_the_frame_and_stay_within_it(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assume(tiles)
    assert tiles[0].rect == (0, 0, width, height)
    for tile in tiles:
        left, top, columns, rows = tile.rect
        assert left >= 0 and top >= 0 and left + columns <= width and top + rows <= height
    # Tiles are a grid, so along each side their spans must leave no gap.
    for first, side in ((0, width), (1, height)):
        covered = 0
        for start, length in sorted({tile.rect[first::2] for tile in tiles[1:]}):
            assert start <= covered
            covered = max(covered, start + length)
        assert len(tiles) == 1 or covered == side


@given(width=sides, height=sides, min_person_px=people)
def test_overview_and_tiles_are_within_their_bounds(
    width: int, height: int, min_person_px: int
) -> None:
    whole, *tiles = tiles_of(width, height, min_person_px) or [Tile((0, 0, 1, 1), 1.0)]
    long_px, short_px = OVERVIEW_PX
    assert max(whole.size) <= long_px and min(whole.size) <= short_px
    for tile in tiles:
        columns, rows = tile.size
        # Tiles end on whole pixels of the frame: up to two more on each side after resizing.
        more = 2 * max(tile.factor, 1)
        assert (columns - more) * (rows - more) <= MAX_TILE_PX
        assert max(columns, rows) <= MAX_FINE_SIDE_PX + more


@given(width=sides, height=sides, min_person_px=people)
def test_smallest_wanted_person_is_seen_large_enough(
    width: int, height: int, min_person_px: int
) -> None:
    whole, tiles = tiles_of(width, height), tiles_of(width, height, min_person_px)
    assert tiles[:1] == whole
    assume(tiles)
    if min_person_px * whole[0].factor >= MIN_PERSON_PX:
        assert tiles == whole
    finest = max(tile.factor for tile in tiles)
    assert min(width, height) * finest >= MIN_SIDE_PX * (1 - 1e-9)
    wanted = min(
        MIN_PERSON_PX / min_person_px,
        MAX_FINE_SIDE_PX / max(width, height),
        math.sqrt(MAX_FINE_PX / (width * height)),
    )
    assert finest * MIN_GAIN >= wanted * (1 - 1e-9)
    # Nor finer than that, but for the overview.
    assert finest <= max(wanted, tiles[0].factor) * (1 + 1e-9)


@pytest.mark.parametrize("frame", [(2000, 2), (2, 2000), (10**6, 12), (1, 1), (7, 7)])
def test_thin_frames_are_not_searched(frame: tuple[int, int]) -> None:
    assert tiles_of(*frame, 50) == []
