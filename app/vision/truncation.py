"""Telling bodies that are seen whole from those that the frame or another person cuts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.vision.people import Box, Silhouette

# Along how much of its extent a silhouette may run on the frame's border: a shoe that just
# reaches the last row is no cut.
_ALONG_BORDER = 0.1
# How much of a person's box a nearer one may fill.
_COVERED = 0.05


def with_truncation(
    silhouettes: Sequence[Silhouette | None],
    boxes: Sequence[Box],
    frame_shape: tuple[int, ...],
) -> list[Silhouette | None]:
    """Set the flag ``truncated`` of the silhouettes of one frame.

    Parameters
    ----------
    silhouettes : sequence of Silhouette or None
    boxes : sequence of Box
        Where each was looked for; stands in for the silhouettes that were not found.
    frame_shape : tuple of int
        Height and width first.

    Returns
    -------
    list of Silhouette or None
    """
    result: list[Silhouette | None] = []
    for index, silhouette in enumerate(silhouettes):
        if silhouette is None:
            result.append(None)
            continue
        others = [
            other or box
            for i, (other, box) in enumerate(zip(silhouettes, boxes, strict=True))
            if i != index
        ]
        flag = touches_border(silhouette, frame_shape) or hidden_by_others(silhouette, others)
        result.append(replace(silhouette, truncated=flag))
    return result


def touches_border(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> bool:
    """Whether the frame's border cuts the person."""
    height, width = frame_shape[:2]
    crop = silhouette.crop
    rows, columns = crop.shape
    along = []
    if silhouette.left == 0:
        along.append(np.count_nonzero(crop[:, 0]) / rows)
    if silhouette.left + columns == width:
        along.append(np.count_nonzero(crop[:, -1]) / rows)
    if silhouette.top == 0:
        along.append(np.count_nonzero(crop[0]) / columns)
    if silhouette.top + rows == height:
        along.append(np.count_nonzero(crop[-1]) / columns)
    return any(share > _ALONG_BORDER for share in along)


def hidden_by_others(silhouette: Silhouette, others: Sequence[Silhouette | Box]) -> bool:
    """Whether a nearer person, one whose feet are lower in the frame, covers part of this one.

    Of a person known by the box alone, half the shared area counts as covered.
    """
    box = silhouette.box
    for other in others:
        other_box = other.box if isinstance(other, Silhouette) else other
        if other_box.bottom <= box.bottom or box.intersection(other_box) == 0:
            continue
        if isinstance(other, Silhouette):
            covered = _pixels_inside(other, box)
        else:
            covered = 0.5 * box.intersection(other_box)
        if covered > _COVERED * box.area:
            return True
    return False


def _pixels_inside(silhouette: Silhouette, box: Box) -> float:
    left, top, right, bottom = box.pixels()
    rows = slice(max(0, top - silhouette.top), max(0, bottom - silhouette.top))
    columns = slice(max(0, left - silhouette.left), max(0, right - silhouette.left))
    return float(np.count_nonzero(silhouette.crop[rows, columns]))
