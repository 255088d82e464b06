"""Telling bodies that are seen whole from those that the frame or another person cuts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.vision.geometry import COCO_NAMES, Box, ObservedKeypoints, Silhouette

# All of this was chosen on even-numbered photographs: see docs/history.md.
# Who is cut by the frame's edge ends at it, or so near to it as silhouettes are precise: in pixels,
# and as a share of the person's longer side.
_NEAR_PX = 1.0
_NEAR = 0.01
# Along how much of its extent a silhouette may run on the frame's border: a shoe that just
# reaches the last row is no cut.
_ALONG_BORDER = 0.1
# Where the head or the feet are not seen, a box ends farther from the edge that hides them.
_NEAR_UNSEEN = 0.05
_LEAST_SCORE = 0.3
_HEAD = [i for i, name in enumerate(COCO_NAMES) if name.endswith(("nose", "eye", "ear"))]
_FEET = [i for i, name in enumerate(COCO_NAMES) if name.endswith("ankle")]
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
    """Whether a silhouette runs along the frame's border; a caller's mask is exact to the pixel."""
    crop = silhouette.crop
    near = 0.0 if silhouette.segmenter == "mask" else max(_NEAR_PX, _NEAR * max(crop.shape))
    # As seen from each edge: how far each row or column of the silhouette is from it.
    for gap, seen in zip(
        _gaps(silhouette.box, frame_shape),
        (crop, crop.T, crop[:, ::-1], crop.T[:, ::-1]),
        strict=True,
    ):
        if gap <= near and seen[:, : int(near - gap) + 1].any(axis=1).mean() > _ALONG_BORDER:
            return True
    return False


def end_beyond_border(box: Box, keypoints: ObservedKeypoints, frame_shape: tuple[int, ...]) -> bool:
    """Whether the frame cuts off the head or the feet: no keypoint of them is seen inside it.

    Parameters
    ----------
    box : Box
        Of the person.
    keypoints : ObservedKeypoints
    frame_shape : tuple of int
        Height and width first.
    """
    height, width = frame_shape[:2]
    inside = ((keypoints.positions > -0.5) & (keypoints.positions < [width, height])).all(axis=1)
    seen = inside & (keypoints.scores >= _LEAST_SCORE)
    whole = seen[_HEAD].any() and seen[_FEET].any()
    return ends_at_border(box, frame_shape) and not whole


def ends_at_border(box: Box, frame_shape: tuple[int, ...]) -> bool:
    """Whether the box of somebody ends so near the frame's edge that it may cut them."""
    return min(_gaps(box, frame_shape)) <= _NEAR_UNSEEN * max(box.width, box.height)


def _gaps(box: Box, frame_shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Pixels between a box and the frame's left, upper, right and lower edge."""
    height, width = frame_shape[:2]
    return box.x + 0.5, box.y + 0.5, width - 0.5 - box.right, height - 0.5 - box.bottom


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
