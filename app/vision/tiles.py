"""The sizes and tiles in which a frame is shown to MoveNet.

The whole frame is shown once. Where the smallest wanted person would be too small in it, the frame
is shown again at a higher resolution, in overlapping tiles to bound the memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.vision.windows import Window

OVERVIEW_ROWS, OVERVIEW_COLUMNS = 352, 640
"""Largest size at which the whole frame is shown: a camera of more pixels does not cost more."""

SMALLEST_SHARE = 1 / 12
"""Height of the smallest wanted person by default, as a share of the frame's height."""

SMALLEST_PERSON_PX = OVERVIEW_ROWS * SMALLEST_SHARE
"""Height at which the smallest wanted person is shown."""

WORTHWHILE = 1.1
"""Least ratio of the tiles' resolution to the overview's; below it tiles add nothing."""

LARGEST_FACTOR = 1.5
"""Frames are enlarged by no more than this."""

LONGEST_PX, LARGEST_PX = 1280, 1280 * 720
"""Longer side and area at the finest resolution, so that a frame of any size takes a bounded
time."""

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
        """Width and height as shown, in pixels."""
        _, _, width, height = self.window
        return max(1, round(width * self.factor)), max(1, round(height * self.factor))


def tiles_of(width: int, height: int, min_person_px: float | None = None) -> list[Tile]:
    """The overview of a frame, and the tiles that show people as small as wanted.

    Parameters
    ----------
    width, height : int
        Of the frame, in pixels.
    min_person_px : float, optional
        Height of the smallest person wanted, in pixels of the frame; by default
        :data:`SMALLEST_SHARE` of the frame's height.

    Returns
    -------
    list of Tile
        The overview, then the tiles; none for a frame too thin to hold a person.
    """
    # Portraits are shown as large as landscapes.
    longer, shorter = max(width, height), min(width, height)
    overview = min(OVERVIEW_COLUMNS / longer, OVERVIEW_ROWS / shorter, LARGEST_FACTOR)
    if shorter * overview < THINNEST_PX:
        return []
    whole = Tile((0, 0, width, height), overview)
    if min_person_px is None:
        return [whole]
    fine = min(
        LONGEST_PX / longer,
        math.sqrt(LARGEST_PX / (width * height)),
        SMALLEST_PERSON_PX / min_person_px,
    )
    if fine <= WORTHWHILE * overview:
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
