"""Silhouettes of the people in a frame, and whether they are truncated.

They come from the landmark network's masks or a caller's mask. A body is truncated if the frame's
border or another person cuts it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import Box
from app.vision.masks import LabelImage, fill_small_holes, keep_components
from app.vision.people import (
    LANDMARK_NAMES,
    Landmarks,
    Silhouette,
    landmark_rows,
    silhouette_from_mask,
)


def silhouettes_of(
    readings: Sequence[PoseReading],
    boxes: Sequence[Box],
    frame_shape: tuple[int, ...],
    *,
    exact: bool,
    checkpoint: Callable[[], None] = lambda: None,
) -> list[Silhouette | None]:
    """Cut people out of the masks of the readings of all people known in a frame.

    A pixel in several people's masks goes to the person with the highest probability. Unless the
    boxes are exact, limbs may reach beyond them. ``checkpoint`` is called before each person; it
    raises an error if the work is no longer wanted. None stands where the network did not see the
    person.
    """
    height, width = frame_shape[:2]
    regions = [
        _region(box if exact else _with_landmarks(box, reading), width, height)
        for box, reading in zip(boxes, readings, strict=True)
    ]
    found: list[Silhouette | None] = []
    for own, region in enumerate(regions):
        checkpoint()
        rivals = [
            (readings[other], other < own)
            for other, theirs in enumerate(regions)
            if region and theirs and other != own and region.intersection(theirs) > 0
        ]
        found.append(_cut_out(readings[own], rivals, region) if region else None)
    return with_truncation(found, boxes, frame_shape)


def silhouettes_from_labels(image: LabelImage) -> list[Silhouette]:
    """Silhouettes of a caller's mask, from left to right by the middle of their boxes."""
    found = []
    for label, box in zip(image.present, image.boxes, strict=True):
        left, top, right, bottom = box.pixels()
        crop = image.labels[top:bottom, left:right] == label
        found.append(Silhouette(crop, left, top, "mask", truncated=False))
    flagged = with_truncation(found, image.boxes, image.labels.shape)
    return sorted(
        (person for person in flagged if person is not None),
        key=lambda person: person.box.x + person.box.width / 2,
    )


_EARS, _SHOULDERS = landmark_rows("ear"), landmark_rows("shoulder")

# Landmarks of at least this visibility widen a box, by a margin that is a share of its longer side.
_MIN_VISIBILITY = 0.5
_LANDMARK_MARGIN = 0.04
# Distance from the ears to the crown, relative to that from the shoulders to the ears.
_SHOULDERS_TO_CROWN = 0.7


def _with_landmarks(box: Box, reading: PoseReading) -> Box:
    """A box widened to the visible landmarks and, where the ears are visible, to the crown."""
    visible = reading.landmarks.visibility >= _MIN_VISIBILITY
    if not visible.any():
        return box
    positions = reading.landmarks.positions[visible]
    if visible[_EARS].all() and visible[_SHOULDERS].all():
        ears, shoulders = (
            reading.landmarks.positions[rows].mean(0) for rows in (_EARS, _SHOULDERS)
        )
        positions = np.vstack([positions, ears + _SHOULDERS_TO_CROWN * (ears - shoulders)])
    margin = _LANDMARK_MARGIN * max(box.width, box.height)
    left, top = (positions.min(axis=0) - margin).tolist()
    right, bottom = (positions.max(axis=0) + margin).tolist()
    return Box.from_edges(
        min(box.x, left), min(box.y, top), max(box.right, right), max(box.bottom, bottom)
    )


# Boxes that end this close to the frame's edge are extended to it: the mask shows better than the
# box whether the body continues.
_EDGE_PX = 5.0


def _region(box: Box, width: int, height: int) -> Box | None:
    """The part of a frame to cut a person out of: the box, extended to nearby edges."""
    inside = box.clip(width, height)
    if inside is None:
        return None
    left, top, _, _ = inside.pixels()
    if left >= width or top >= height:
        return None  # A sliver at the edge holds no pixel.
    sides = np.array([inside.x, inside.y, inside.right, inside.bottom])
    edges = np.array([-0.5, -0.5, width - 0.5, height - 0.5])
    near = np.abs(sides - edges) <= _EDGE_PX
    return Box.from_edges(*np.where(near, edges, sides).tolist())


_MAX_SIDE_PX = 384  # Largest size at which masks are drawn and cleaned.
_MIN_PROBABILITY = 0.5  # Of a person's pixels; chosen on even-numbered photographs.
_MIN_PART = 0.1  # Area relative to the largest part; smaller parts are dropped.
_MAX_HOLE = 0.01  # Area relative to the mask; larger holes stay.
_MIN_COVER = 0.5  # Least share of a person's pixel that the drawn mask covers.
_MIN_FILL = 0.12  # Filled share of the box below which the network saw nobody.


def _cut_out(
    reading: PoseReading,
    rivals: Sequence[tuple[PoseReading, bool]],
    region: Box,
) -> Silhouette | None:
    """Cut one person out of a region; None if next to nothing is left.

    ``rivals`` are the readings of other people in the region, and whether they win ties.
    """
    left, top, right, bottom = region.pixels()
    width, height = right - left, bottom - top
    scale = min(1.0, _MAX_SIDE_PX / max(width, height))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    # From pixels as drawn to pixels of the frame.
    to_frame = np.array(
        [
            [width / size[0], 0, left + 0.5 * width / size[0] - 0.5],
            [0, height / size[1], top + 0.5 * height / size[1] - 0.5],
        ]
    )
    own = _probability(reading, to_frame, size)
    mask = own >= _MIN_PROBABILITY
    for rival, wins_ties in rivals:
        theirs = _probability(rival, to_frame, size)
        mask &= own > theirs if wins_ties else own >= theirs
    mask = fill_small_holes(keep_components(mask, _MIN_PART), _MAX_HOLE)
    inside = cv2.resize(mask.astype(np.float32), (width, height)) >= _MIN_COVER
    if np.count_nonzero(inside) < _MIN_FILL * inside.size:
        return None
    return silhouette_from_mask(inside, left=left, top=top, segmenter="network")


def _probability(
    reading: PoseReading, to_frame: NDArray[np.float64], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Draw a reading's mask at ``size``, whose pixels ``to_frame`` ``(2, 3)`` maps to the frame."""
    from_frame = cv2.invertAffineTransform(reading.window.to_frame(LANDMARK_PX))
    linear = from_frame[:, :2] @ to_frame[:, :2]
    offset = from_frame[:, :2] @ to_frame[:, 2] + from_frame[:, 2]
    matrix = np.column_stack([linear, offset])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    assert reading.probability is not None
    return np.asarray(cv2.warpAffine(reading.probability, matrix, size, flags=flags))


def with_truncation(
    silhouettes: Sequence[Silhouette | None],
    boxes: Sequence[Box],
    frame_shape: tuple[int, ...],
) -> list[Silhouette | None]:
    """Set the flag ``truncated`` of the silhouettes of one frame.

    The people's boxes stand in for missing silhouettes.
    """
    people = [one or box for one, box in zip(silhouettes, boxes, strict=True)]
    result: list[Silhouette | None] = []
    for row, silhouette in enumerate(silhouettes):
        if silhouette is not None:
            others = people[:row] + people[row + 1 :]
            is_cut = touches_border(silhouette, frame_shape)
            is_cut = is_cut or hidden_by_others(silhouette, others)
            silhouette = replace(silhouette, truncated=is_cut)
        result.append(silhouette)
    return result


# A silhouette ends at an edge if it is as near as this many pixels, or this share of its longer
# side: silhouettes are no more precise. These numbers and the ones below were chosen on
# even-numbered photographs, see docs/history.md.
_BORDER_PX = 1.0
_BORDER_SHARE = 0.01
# Share of its extent along an edge above which a silhouette is cut: a shoe that just reaches the
# last row is not.
_MIN_BORDER_RUN = 0.1


def touches_border(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> bool:
    """Whether a silhouette runs along the frame's border; a caller's mask is exact to the pixel."""
    crop = silhouette.crop
    near = max(_BORDER_PX, _BORDER_SHARE * max(crop.shape))
    if silhouette.segmenter == "mask":
        near = 0.0
    # The crop as seen from each edge; the first columns are nearest to it.
    views = (crop, crop.T, crop[:, ::-1], crop.T[:, ::-1])
    return any(
        gap <= near and view[:, : int(near - gap) + 1].any(axis=1).mean() > _MIN_BORDER_RUN
        for gap, view in zip(gaps_to_border(silhouette.box, frame_shape), views, strict=True)
    )


_HEAD = [LANDMARK_NAMES.index("nose"), *landmark_rows("eye", "ear")]
_FEET = landmark_rows("ankle")
_MIN_SEEN = 0.3  # Visibility from which a landmark is seen.


def end_beyond_border(box: Box, landmarks: Landmarks, frame_shape: tuple[int, ...]) -> bool:
    """Whether the frame cuts off a person's head or feet, so that no landmark of it is seen."""
    height, width = frame_shape[:2]
    inside = ((landmarks.positions > -0.5) & (landmarks.positions < [width, height])).all(axis=1)
    seen = inside & (landmarks.visibility >= _MIN_SEEN)
    is_whole = seen[_HEAD].any() and seen[_FEET].any()
    return ends_at_border(box, frame_shape) and not is_whole


# Distance from the frame's edge within which it may cut a box, as a share of the longer side.
_UNSEEN_END_SHARE = 0.05


def ends_at_border(box: Box, frame_shape: tuple[int, ...]) -> bool:
    """Whether a person's box ends so near the frame's edge that it may cut them."""
    reach = _UNSEEN_END_SHARE * max(box.width, box.height)
    return min(gaps_to_border(box, frame_shape)) <= reach


def gaps_to_border(box: Box, frame_shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Pixels between a box and the frame's left, upper, right and lower edge."""
    height, width = frame_shape[:2]
    return box.x + 0.5, box.y + 0.5, width - 0.5 - box.right, height - 0.5 - box.bottom


_MAX_COVER = 0.05  # Share of a whole person's box that a nearer person may cover.
_BOX_FILL = 0.5  # Share of a box that a person without a silhouette fills.


def hidden_by_others(silhouette: Silhouette, others: Sequence[Silhouette | Box]) -> bool:
    """Whether a nearer person, one whose feet are lower in the frame, covers part of this one."""
    box = silhouette.box
    for other in others:
        other_box = other.box if isinstance(other, Silhouette) else other
        if other_box.bottom <= box.bottom or box.intersection(other_box) == 0:
            continue
        if isinstance(other, Silhouette):
            covered = _pixels_inside(other, box)
        else:
            covered = _BOX_FILL * box.intersection(other_box)
        if covered > _MAX_COVER * box.area:
            return True
    return False


def _pixels_inside(silhouette: Silhouette, box: Box) -> float:
    """Number of a silhouette's pixels inside a box."""
    left, top, right, bottom = box.pixels()
    rows = slice(max(0, top - silhouette.top), max(0, bottom - silhouette.top))
    columns = slice(max(0, left - silhouette.left), max(0, right - silhouette.left))
    return float(np.count_nonzero(silhouette.crop[rows, columns]))
