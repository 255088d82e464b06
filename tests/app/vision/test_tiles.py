"""How a frame is shown to the network: all of it, and at no more cost than a square frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from app.vision.tiles import (
    LARGEST_FACTOR,
    LARGEST_PX,
    LARGEST_TILE_PX,
    LONGEST_PX,
    OVERVIEW_COLUMNS,
    OVERVIEW_ROWS,
    SMALLEST_PERSON_PX,
    THINNEST_PX,
    WORTHWHILE,
    Tile,
    tiles_of,
)

people = st.integers(16, 400)
sides = st.integers(1, 6000)


def shown_px(tiles: list[Tile]) -> int:
    return sum(math.prod(tile.size) for tile in tiles)


@given(width=sides, height=sides, min_person_px=people)
def test_tiles_cover_the_frame_and_stay_within_it(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assume(tiles)
    assert tiles[0].window == (0, 0, width, height)
    for tile in tiles:
        left, top, columns, rows = tile.window
        assert left >= 0 and top >= 0 and left + columns <= width and top + rows <= height
    if len(tiles) > 1:
        # Tiles are a grid, so along each side their spans must leave no gap.
        for start, length, side in ((0, 2, width), (1, 3, height)):
            spans = sorted({(one.window[start], one.window[length]) for one in tiles[1:]})
            covered = 0
            for first, size in spans:
                assert first <= covered
                covered = max(covered, first + size)
            assert covered == side


OVERVIEW_PX = OVERVIEW_ROWS * OVERVIEW_COLUMNS


@given(width=sides, height=sides, min_person_px=people)
def test_nothing_larger_is_shown_than_allowed(width: int, height: int, min_person_px: int) -> None:
    whole, *tiles = tiles_of(width, height, min_person_px) or [Tile((0, 0, 1, 1), 1.0)]
    assert max(whole.size) <= OVERVIEW_COLUMNS and min(whole.size) <= OVERVIEW_ROWS
    for tile in tiles:
        columns, rows = tile.size
        # Windows end on whole pixels: up to two more on each side, as shown.
        more = 2 * max(tile.factor, 1)
        assert (columns - more) * (rows - more) <= LARGEST_TILE_PX
        assert max(columns, rows) <= LONGEST_PX + more


@given(width=sides, height=sides, factor=st.floats(1, 9))
def test_a_frame_of_more_pixels_costs_no_more_by_default(
    width: int, height: int, factor: float
) -> None:
    """One pass, of at most the overview's pixels, whatever the camera's."""
    tiles = tiles_of(width, height)
    larger = tiles_of(round(width * factor), round(height * factor))
    assert len(tiles) <= 1 and len(larger) <= 1
    assert shown_px(larger) <= OVERVIEW_PX
    longer = max(width, height)
    if tiles and tiles[0].factor < LARGEST_FACTOR:
        # Sides are rounded to whole pixels, in the frame and as shown.
        assert shown_px(larger) <= shown_px(tiles) + 3 * max(OVERVIEW_COLUMNS, longer)


@given(width=sides, height=sides, min_person_px=people)
def test_tiles_are_shown_only_where_small_people_are_asked_for(
    width: int, height: int, min_person_px: int
) -> None:
    whole, asked = tiles_of(width, height), tiles_of(width, height, min_person_px)
    assert asked[:1] == whole
    if whole and min_person_px * whole[0].factor >= SMALLEST_PERSON_PX:
        assert asked == whole


@given(width=sides, height=sides, min_person_px=people)
def test_the_smallest_wanted_person_is_shown_as_large_as_needed(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assume(tiles)
    finest = max(tile.factor for tile in tiles)
    wanted = min(
        SMALLEST_PERSON_PX / min_person_px,
        LONGEST_PX / max(width, height),
        math.sqrt(LARGEST_PX / (width * height)),
    )
    assert finest * WORTHWHILE >= wanted * (1 - 1e-9)
    # Nor finer than that, but for the overview.
    assert finest <= max(wanted, tiles[0].factor) * (1 + 1e-9)


@given(width=st.integers(1, 10**7), height=st.integers(1, 10**7), min_person_px=people)
def test_a_frame_of_any_size_takes_a_bounded_time(
    width: int, height: int, min_person_px: int
) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assert shown_px(tiles) <= 2 * LARGEST_PX + OVERVIEW_PX


@pytest.mark.parametrize("frame", [(2000, 2), (2, 2000), (10**6, 12), (1, 1), (7, 7)])
def test_nobody_is_looked_for_in_thin_frames(frame: tuple[int, int]) -> None:
    assert tiles_of(*frame, 50) == []


@given(width=sides, height=sides, min_person_px=people)
def test_who_is_shown_at_all_is_not_too_thin(width: int, height: int, min_person_px: int) -> None:
    tiles = tiles_of(width, height, min_person_px)
    assume(tiles)
    finest = max(tile.factor for tile in tiles)
    assert min(width, height) * finest >= THINNEST_PX * (1 - 1e-9)


@pytest.mark.parametrize("frame", [(298, 320), (640, 480), (1280, 720), (200, 2000)])
def test_a_turned_frame_has_turned_tiles(frame: tuple[int, int]) -> None:
    def windows(tiles: list[Tile]) -> np.ndarray:
        return np.array(sorted(tile.window for tile in tiles))

    here, there = tiles_of(*frame, 40), tiles_of(*frame[::-1], 40)
    assert shown_px(here) == pytest.approx(shown_px(there), rel=0.02)
    assert sorted(map(tuple, windows(there)[:, [1, 0, 3, 2]].tolist())) == sorted(
        map(tuple, windows(here).tolist())
    )
