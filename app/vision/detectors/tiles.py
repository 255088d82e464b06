"""A frame as detectors see it: an overview and, if small people are wanted, tiles.

The overview has a bounded size, whatever the camera. Tiles show the frame again at a higher
resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, PixelRect, crop, shrink_quickly
from app.vision.halved import Frame, seen_at
from app.vision.truncation import gaps_to_border


@dataclass(frozen=True)
class Tile:
    """A part of a frame as a detector sees it."""

    rect: PixelRect  # (left, top, width, height): in pixels of the frame
    factor: float  # factor by which the part is resized

    @property
    def size(self) -> tuple[int, int]:
        _, _, width, height = self.rect
        return max(1, round(width * self.factor)), max(1, round(height * self.factor))

    def to_frame(self, box: Box, frame_shape: tuple[int, ...]) -> Box | None:
        """A box of this tile in pixels of the frame.

        None if it lies outside the frame, or ends at an edge of the tile that is not an edge of the
        frame, since such a person is cut off.
        """
        left, top, columns, rows = self.rect
        height, width = frame_shape[:2]
        whole = box.scaled(1 / self.factor)
        is_seam = (left > 0, top > 0, left + columns < width, top + rows < height)
        gaps = gaps_to_border(whole, (rows, columns))
        # A box that ends so close to a seam, as a detector sees it, is cut.
        if any(gap < 4.0 / self.factor for gap, seam in zip(gaps, is_seam, strict=True) if seam):
            return None
        return Box(whole.x + left, whole.y + top, whole.width, whole.height).clip(width, height)


@dataclass(frozen=True)
class Picture:
    """A frame ``(H, W, 3)``, BGR, and the tiles that detectors see; the first is the overview.

    A frame too thin to hold a person has no tiles.
    """

    frame: Frame
    tiles: tuple[Tile, ...]

    @classmethod
    def of(cls, frame: Frame, min_person_px: float | None) -> Picture:
        height, width = frame.shape[:2]
        return cls(frame, tuple(tiles_of(width, height, min_person_px)))

    @cached_property
    def overview(self) -> NDArray[np.uint8]:
        tile = self.tiles[0]
        return shrink_quickly(seen_at(self.frame, tile.factor)[0], *tile.size)

    def seen_in(self, tile: Tile) -> NDArray[np.uint8]:
        if tile is self.tiles[0]:
            return self.overview
        pixels, scale = seen_at(self.frame, tile.factor)
        left, top, width, height = (math.ceil(scale * side) for side in tile.rect)
        return shrink_quickly(crop(pixels, (left, top, width, height)), *tile.size)


OVERVIEW_PX = (640, 352)
"""Largest sides of the overview: a camera with more pixels does not cost more."""

MIN_SIDE_PX = 12
"""Shortest side of the overview; thinner frames cannot show a person."""

# Height of the smallest person wanted by default, as a share of the frame's height.
_MIN_PERSON_SHARE = 1 / 12

MIN_PERSON_PX = OVERVIEW_PX[1] * _MIN_PERSON_SHARE
"""Height at which detectors see the smallest wanted person."""

MIN_GAIN = 1.1
"""Gain in resolution over the overview up to which tiles add nothing."""

MAX_FINE_SIDE_PX, MAX_FINE_PX = 1280, 1280 * 720
"""Largest side and area of the frame at the resolution of the tiles; they bound the time."""


def smallest_person_px(frame_shape: tuple[int, ...], min_person_px: float | None) -> float:
    """Height of the smallest person wanted, in pixels: a share of the frame's unless given."""
    if min_person_px is not None:
        return min_person_px
    return max(1.0, _MIN_PERSON_SHARE * frame_shape[0])


def tiles_of(width: int, height: int, min_person_px: float | None = None) -> list[Tile]:
    """The overview of a frame, and tiles at a higher resolution if small people are wanted.

    Parameters
    ----------
    width, height : int
        Of the frame, in pixels.
    min_person_px : float, optional
        Height of the smallest person wanted, in pixels of the frame; by default a share of its
        height, for which the overview is enough.

    Returns
    -------
    list of Tile
        The overview first; empty for a frame too thin to hold a person.
    """
    # Portrait frames are seen as large as landscape frames.
    longer, shorter = max(width, height), min(width, height)
    long_px, short_px = OVERVIEW_PX
    overview = min(long_px / longer, short_px / shorter, 1.5)
    if shorter * overview < MIN_SIDE_PX:
        return []
    whole = Tile((0, 0, width, height), overview)
    if min_person_px is None:
        return [whole]
    fine = min(
        MAX_FINE_SIDE_PX / longer,
        math.sqrt(MAX_FINE_PX / (width * height)),
        MIN_PERSON_PX / min_person_px,
    )
    if fine <= MIN_GAIN * overview:
        return [whole]
    return [whole, *(Tile(rect, fine) for rect in _grid(width, height, fine))]


MAX_TILE_PX = 160_000
"""Area of a tile as detectors see it, which bounds the memory."""


def _grid(width: int, height: int, factor: float) -> list[PixelRect]:
    """Overlapping tiles, small enough when resized by ``factor``, with the smallest total area."""
    # Overlap of tiles, so that a person at a seam is whole in the next tile or the overview.
    overlap = 96 / factor
    counts = range(1, 9)
    widths = {columns: _part(width, columns, overlap) for columns in counts}
    heights = {rows: _part(height, rows, overlap) for rows in counts}
    _, columns, rows = min(
        (columns * widths[columns] * rows * heights[rows], columns, rows)
        for columns in counts
        for rows in counts
        if widths[columns] * heights[rows] * factor**2 <= MAX_TILE_PX
    )
    return [
        (left, top, right - left, bottom - top)
        for top, bottom in _spans(height, rows, overlap)
        for left, right in _spans(width, columns, overlap)
    ]


def _part(length: int, count: int, overlap: float) -> float:
    return (length + (count - 1) * overlap) / count


def _spans(length: int, count: int, overlap: float) -> list[tuple[int, int]]:
    part = _part(length, count, overlap)
    starts = [round(i * (part - overlap)) for i in range(count)]
    return [(start, min(length, math.ceil(start + part))) for start in starts]
