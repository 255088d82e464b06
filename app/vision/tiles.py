"""The overview and the overlapping tiles in which MoveNet sees a frame; tiles bound the memory."""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.vision.crops import PixelRect
from app.vision.geometry import Box
from app.vision.parameters import DEFAULTS, TilingParameters


@dataclass(frozen=True)
class Tile:
    """A part of a frame as MoveNet sees it.

    Parameters
    ----------
    rect : (left, top, width, height)
        In pixels of the frame.
    factor : float
        Factor by which the part is resized.
    """

    rect: PixelRect
    factor: float

    @property
    def size(self) -> tuple[int, int]:
        """Width and height after resizing, in pixels."""
        _, _, width, height = self.rect
        return max(1, round(width * self.factor)), max(1, round(height * self.factor))

    def to_frame(self, box: Box, width: int, height: int, seam_px: float) -> Box | None:
        """A box of this tile in pixels of the frame.

        None if it lies outside the frame, or ends within ``seam_px`` of an edge of the tile that is
        not an edge of the frame, since such a person is cut off.
        """
        left, top, columns, rows = self.rect
        seam = seam_px / self.factor
        whole = box.scaled(1 / self.factor)
        is_cut = (
            (left > 0 and whole.x < seam)
            or (top > 0 and whole.y < seam)
            or (left + columns < width and whole.right > columns - seam)
            or (top + rows < height and whole.bottom > rows - seam)
        )
        if is_cut:
            return None
        return Box(whole.x + left, whole.y + top, whole.width, whole.height).clip(width, height)


def tiles_of(
    width: int,
    height: int,
    min_person_px: float | None = None,
    parameters: TilingParameters = DEFAULTS.tiling,
) -> list[Tile]:
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
    long_px, short_px = parameters.overview_px
    overview = min(long_px / longer, short_px / shorter, parameters.max_enlargement)
    if shorter * overview < parameters.min_side_px:
        return []
    whole = Tile((0, 0, width, height), overview)
    if min_person_px is None:
        return [whole]
    fine = min(
        parameters.max_fine_side_px / longer,
        math.sqrt(parameters.max_fine_px / (width * height)),
        parameters.min_person_px / min_person_px,
    )
    if fine <= parameters.min_gain * overview:
        return [whole]
    return [whole, *(Tile(rect, fine) for rect in _grid(width, height, fine, parameters))]


def _grid(width: int, height: int, factor: float, parameters: TilingParameters) -> list[PixelRect]:
    """Overlapping tiles, small enough when resized by ``factor``, with the smallest total area."""
    overlap = parameters.overlap_px / factor
    counts = range(1, parameters.max_tiles_per_side + 1)
    widths = {columns: _part(width, columns, overlap) for columns in counts}
    heights = {rows: _part(height, rows, overlap) for rows in counts}
    _, columns, rows = min(
        (columns * widths[columns] * rows * heights[rows], columns, rows)
        for columns in counts
        for rows in counts
        if widths[columns] * heights[rows] * factor**2 <= parameters.max_tile_px
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


def smallest_person_px(
    frame_shape: tuple[int, ...],
    min_person_px: float | None,
    parameters: TilingParameters = DEFAULTS.tiling,
) -> float:
    """Height of the smallest person wanted, in pixels: a share of the frame's unless given."""
    if min_person_px is not None:
        return min_person_px
    return max(1.0, parameters.min_person_share * frame_shape[0])
