"""The tiles in which MoveNet sees a frame."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from app.vision.detector import (
    MAX_ENLARGEMENT,
    MAX_FINE_PX,
    MAX_FINE_SIDE_PX,
    MAX_TILE_PX,
    MIN_GAIN,
    MIN_PERSON_PX,
    MIN_SIDE_PX,
    OVERVIEW_PX,
    Tile,
    tiles_of,
)

people = st.integers(16, 400)
sides = st.integers(1, 6000)


def seen_px(tiles: list[Tile]) -> int:
    """Pixels that MoveNet sees."""
    return sum(math.prod(tile.size) for tile in tiles)


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


@given(width=sides, height=sides, factor=st.floats(1, 9))
def test_frame_of_more_pixels_costs_no_more_by_default(
    width: int, height: int, factor: float
) -> None:
    tiles = tiles_of(width, height)
    larger = tiles_of(round(width * factor), round(height * factor))
    assert len(tiles) <= 1 and len(larger) <= 1
    assert seen_px(larger) <= math.prod(OVERVIEW_PX)
    if tiles and tiles[0].factor < MAX_ENLARGEMENT:
        # Sides are rounded to whole pixels, in the frame and after resizing.
        slack = 3 * max(*OVERVIEW_PX, width, height)
        assert seen_px(larger) <= seen_px(tiles) + slack


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


@given(width=st.integers(1, 10**7), height=st.integers(1, 10**7), min_person_px=people)
def test_frames_of_any_size_take_a_bounded_time(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assert seen_px(tiles) <= 2 * MAX_FINE_PX + math.prod(OVERVIEW_PX)


@pytest.mark.parametrize("frame", [(2000, 2), (2, 2000), (10**6, 12), (1, 1), (7, 7)])
def test_thin_frames_are_not_searched(frame: tuple[int, int]) -> None:
    assert tiles_of(*frame, 50) == []


@pytest.mark.parametrize("frame", [(298, 320), (640, 480), (1280, 720), (200, 2000)])
def test_rotated_frame_has_rotated_tiles(frame: tuple[int, int]) -> None:
    here, there = tiles_of(*frame, 40), tiles_of(*frame[::-1], 40)
    assert seen_px(here) == pytest.approx(seen_px(there), rel=0.02)
    transposed = [tuple(tile.rect[i] for i in (1, 0, 3, 2)) for tile in there]
    assert sorted(transposed) == sorted(tile.rect for tile in here)
