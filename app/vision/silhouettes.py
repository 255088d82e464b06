"""Silhouettes of the people in a frame, from the landmark network's masks or a caller's mask."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import Box
from app.vision.masks import MIN_FILL, LabelImage, cleaned
from app.vision.people import Silhouette, landmark_rows, silhouette_from_mask
from app.vision.truncation import extended_to_border, with_truncation


@dataclass(frozen=True)
class DrawnSilhouette:
    """A silhouette, and the landmarks ``(33, 2)`` of the reading that it was drawn from, pixels."""

    silhouette: Silhouette
    positions: NDArray[np.float64]

    def on_landmarks(self, reading: PoseReading, frame_shape: tuple[int, ...]) -> Silhouette | None:
        """The silhouette, moved and stretched along with the landmarks of a later reading.

        None if it has to be drawn again: the body has another shape, or is cut.
        """
        old, (height, width) = self.silhouette, frame_shape[:2]
        before, now = self.positions, reading.landmarks.positions
        apart = (now - now.mean(axis=0)) - (before - before.mean(axis=0))
        # Mean distance, in sizes of the body, up to which landmarks that moved against each other
        # since a silhouette was drawn leave it as it is.
        changed = np.linalg.norm(apart, axis=1).mean() > 0.1 * reading.body_px
        if changed or old.truncated:
            return None
        low, high = now.min(axis=0) - before.min(axis=0), now.max(axis=0) - before.max(axis=0)
        corner = np.array([old.left, old.top])
        first = np.rint(corner + low).astype(int)
        last = np.rint(corner + np.array(old.crop.shape[::-1]) + high).astype(int)
        size = last - first
        if (first < 0).any() or (last > [width, height]).any() or (size < 1).any():
            return None
        crop = cv2.resize(old.crop.view(np.uint8), size.tolist(), interpolation=cv2.INTER_NEAREST)
        left, top = first.tolist()
        return silhouette_from_mask(crop > 0, left=left, top=top, segmenter=old.segmenter)


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
    raises an error if the work is no longer wanted. None stands for a person that the network did
    not see.
    """
    regions = [
        _region(box if exact else _with_landmarks(box, reading), frame_shape)
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
        # Distance from the ears to the crown, relative to that from the shoulders to the ears.
        positions = np.vstack([positions, ears + 0.7 * (ears - shoulders)])
    margin = _LANDMARK_MARGIN * max(box.width, box.height)
    left, top = (positions.min(axis=0) - margin).tolist()
    right, bottom = (positions.max(axis=0) + margin).tolist()
    return box.joined(Box.from_edges(left, top, right, bottom))


def _region(box: Box, frame_shape: tuple[int, ...]) -> Box | None:
    """The part of a frame to cut a person out of; at the border, the mask shows where they end.

    None for a sliver at the edge that holds no pixel.
    """
    height, width = frame_shape[:2]
    inside = box.clip(width, height)
    if inside is None:
        return None
    left, top, _, _ = inside.pixels()
    if left >= width or top >= height:
        return None
    return extended_to_border(inside, frame_shape)


_MIN_PROBABILITY = 0.5  # Of a person's pixels; chosen on even-numbered photographs.


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
    # Largest size at which masks are drawn and cleaned.
    scale = min(1.0, 384 / max(width, height))
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
    mask = cleaned(mask, max_hole=0.01)
    # Least share of a person's pixel that the drawn mask covers.
    inside = cv2.resize(mask.astype(np.float32), (width, height)) >= 0.5
    if np.count_nonzero(inside) < MIN_FILL * inside.size:
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
