"""The sizes and tiles in which a frame is shown to the network.

The whole frame is shown once, small, to find large people. Where the smallest wanted person would
be too small in it, the frame is shown again at a higher resolution, in overlapping tiles to bound
the memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.vision.resampling import Window

OVERVIEW_PX = 320
"""Longer side of the whole frame as it is first shown: of the sizes tried, the one with the highest
average precision (docs/results/scales.md); above 512, people who fill the frame are missed."""

SMALLEST_PERSON_PX = 38.0
"""Height at which the smallest wanted person is shown."""

WORTHWHILE = 1.1
"""Least ratio of the tiles' resolution to the overview's; below it tiles add nothing."""

LONGEST_PX, LARGEST_PX = 1280, 1280 * 720
"""Longer side and area at the finest resolution: people under a 30th of a frame's longer side, a
25th of a square one's, are not searched for, and a frame of any size takes a bounded time."""

LARGEST_TILE_PX = 160_000
"""Area of a tile as shown, in pixels."""

OVERLAP_PX = 96
"""Overlap of tiles as shown: a person cut by a tile is whole in the next or in the overview."""

THINNEST_PX = 12
"""Least shorter side, as shown, of a frame that is searched."""


@dataclass(frozen=True)
class Tile:
    """A part of a frame, and how it is shown.

    Parameters
    ----------
    window : (left, top, width, height)
        Pixels of the frame.
    factor : float
        By which it is resized.
    """

    window: Window
    factor: float

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows as shown."""
        _, _, width, height = self.window
        return max(1, round(width * self.factor)), max(1, round(height * self.factor))


def tiles_of(width: int, height: int, min_person_px: float) -> list[Tile]:
    """Plan the tiles of a frame.

    Parameters
    ----------
    width, height : int
        Of the frame, in pixels.
    min_person_px : float
        Height of the smallest person wanted, in pixels of the frame.

    Returns
    -------
    list of Tile
        The overview, then the tiles; none for a frame too thin to hold a person.
    """
    longer, shorter = max(width, height), min(width, height)
    overview = min(OVERVIEW_PX / longer, SMALLEST_PERSON_PX / min_person_px, 1.0)
    fine = min(
        LONGEST_PX / longer,
        math.sqrt(LARGEST_PX / (width * height)),
        SMALLEST_PERSON_PX / min_person_px,
    )
    if fine <= WORTHWHILE * OVERVIEW_PX / longer:
        overview = fine = min(fine, OVERVIEW_PX / longer)
    if shorter * fine < THINNEST_PX:
        return []
    whole = Tile((0, 0, width, height), overview)
    if fine == overview:
        return [whole]
    return [whole, *(Tile(window, fine) for window in _grid(width, height, fine))]


def _grid(width: int, height: int, factor: float) -> list[Window]:
    """Cut a frame into the fewest overlapping windows that are small enough as shown."""
    overlap = OVERLAP_PX / factor
    columns, rows = min(
        (
            (columns, rows)
            for columns in range(1, 9)
            for rows in range(1, 9)
            if _part(width, columns, overlap) * _part(height, rows, overlap) * factor**2
            <= LARGEST_TILE_PX
        ),
        key=lambda grid: (
            grid[0] * _part(width, grid[0], overlap) * grid[1] * _part(height, grid[1], overlap)
        ),
    )
    return [
        (left, top, right - left, bottom - top)
        for top, bottom in _spans(height, rows, overlap)
        for left, right in _spans(width, columns, overlap)
    ]


def _part(length: int, count: int, overlap: float) -> float:
    """Length of each of ``count`` overlapping parts."""
    return (length + (count - 1) * overlap) / count


def _spans(length: int, count: int, overlap: float) -> list[tuple[int, int]]:
    part = _part(length, count, overlap)
    starts = [round(i * (part - overlap)) for i in range(count)]
    return [(start, min(length, math.ceil(start + part))) for start in starts]
