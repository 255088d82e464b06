"""Whether a body is cut off by the frame's border or covered by another person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.vision.geometry import Box
from app.vision.parameters import DEFAULTS, TruncationParameters
from app.vision.people import ObservedKeypoints, Silhouette, coco_rows

_HEAD, _FEET = coco_rows("nose", "eye", "ear"), coco_rows("ankle")


def with_truncation(
    silhouettes: Sequence[Silhouette | None],
    boxes: Sequence[Box],
    frame_shape: tuple[int, ...],
    parameters: TruncationParameters = DEFAULTS.truncation,
) -> list[Silhouette | None]:
    """Set the flag ``truncated`` of the silhouettes of one frame.

    Parameters
    ----------
    silhouettes : sequence of Silhouette or None
    boxes : sequence of Box
        The people's boxes, which stand in for missing silhouettes.
    frame_shape : tuple of int
        Height and width first.
    """
    people = [one or box for one, box in zip(silhouettes, boxes, strict=True)]
    result: list[Silhouette | None] = []
    for row, silhouette in enumerate(silhouettes):
        if silhouette is not None:
            others = people[:row] + people[row + 1 :]
            is_cut = touches_border(silhouette, frame_shape, parameters)
            is_cut = is_cut or hidden_by_others(silhouette, others, parameters)
            silhouette = replace(silhouette, truncated=is_cut)
        result.append(silhouette)
    return result


def touches_border(
    silhouette: Silhouette,
    frame_shape: tuple[int, ...],
    parameters: TruncationParameters = DEFAULTS.truncation,
) -> bool:
    """Whether a silhouette runs along the frame's border; a caller's mask is exact to the pixel."""
    crop = silhouette.crop
    near = max(parameters.border_px, parameters.border_share * max(crop.shape))
    if silhouette.segmenter == "mask":
        near = 0.0
    # The crop as seen from each edge; the first columns are nearest to it.
    views = (crop, crop.T, crop[:, ::-1], crop.T[:, ::-1])
    return any(
        gap <= near
        and view[:, : int(near - gap) + 1].any(axis=1).mean() > parameters.min_border_run
        for gap, view in zip(_gaps(silhouette.box, frame_shape), views, strict=True)
    )


def end_beyond_border(
    box: Box,
    keypoints: ObservedKeypoints,
    frame_shape: tuple[int, ...],
    parameters: TruncationParameters = DEFAULTS.truncation,
) -> bool:
    """Whether the frame cuts off a person's head or feet, so that no keypoint of it is seen."""
    height, width = frame_shape[:2]
    inside = ((keypoints.positions > -0.5) & (keypoints.positions < [width, height])).all(axis=1)
    seen = inside & (keypoints.scores >= parameters.min_keypoint_score)
    is_whole = seen[_HEAD].any() and seen[_FEET].any()
    return ends_at_border(box, frame_shape, parameters) and not is_whole


def ends_at_border(
    box: Box,
    frame_shape: tuple[int, ...],
    parameters: TruncationParameters = DEFAULTS.truncation,
) -> bool:
    """Whether a person's box ends so near the frame's edge that it may cut them."""
    reach = parameters.unseen_end_share * max(box.width, box.height)
    return min(_gaps(box, frame_shape)) <= reach


def _gaps(box: Box, frame_shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Pixels between a box and the frame's left, upper, right and lower edge."""
    height, width = frame_shape[:2]
    return box.x + 0.5, box.y + 0.5, width - 0.5 - box.right, height - 0.5 - box.bottom


def hidden_by_others(
    silhouette: Silhouette,
    others: Sequence[Silhouette | Box],
    parameters: TruncationParameters = DEFAULTS.truncation,
) -> bool:
    """Whether a nearer person, one whose feet are lower in the frame, covers part of this one."""
    box = silhouette.box
    for other in others:
        other_box = other.box if isinstance(other, Silhouette) else other
        if other_box.bottom <= box.bottom or box.intersection(other_box) == 0:
            continue
        if isinstance(other, Silhouette):
            covered = _pixels_inside(other, box)
        else:
            covered = parameters.box_fill * box.intersection(other_box)
        if covered > parameters.max_cover * box.area:
            return True
    return False


def _pixels_inside(silhouette: Silhouette, box: Box) -> float:
    """Number of a silhouette's pixels inside a box."""
    left, top, right, bottom = box.pixels()
    rows = slice(max(0, top - silhouette.top), max(0, bottom - silhouette.top))
    columns = slice(max(0, left - silhouette.left), max(0, right - silhouette.left))
    return float(np.count_nonzero(silhouette.crop[rows, columns]))
