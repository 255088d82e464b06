"""Silhouettes of the people of a frame, from the network's masks or a caller's own."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, Reading
from app.vision.geometry import Box, Silhouette, silhouette_from_mask
from app.vision.images import LabelImage
from app.vision.truncation import with_truncation
from app.vision.windows import window_to_frame


def fill_small_holes(mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Fill holes smaller than ``share`` of the mask's area.

    Larger ones stay: the gap between an arm and the trunk tells the pose.

    Parameters
    ----------
    mask : (H, W) bool array
    share : float
        0 fills nothing, 1 everything that is enclosed.

    Returns
    -------
    (H, W) bool array
    """
    limit = share * np.count_nonzero(mask)
    # A ring of background, so that the outside is one component, number `labels[0, 0]`.
    background = np.pad(~mask, 1, constant_values=True).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(background, connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] <= limit
    small[0] = False  # the mask itself
    small[labels[0, 0]] = False
    if count <= 2 or not small.any():
        return mask
    return np.asarray(mask | small[labels[1:-1, 1:-1]])


def keep_components(mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Keep the largest connected part and those of at least ``share`` of its area.

    A lamp post may part a leg from its body, so one part need not be all.

    Parameters
    ----------
    mask : (H, W) bool array
    share : float
        1 keeps the largest part alone.

    Returns
    -------
    (H, W) bool array
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count <= 2:
        return mask
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    keep = areas >= share * areas.max()
    keep[0] = False
    keep[areas.argmax()] = True
    return np.asarray(keep[labels])


def silhouettes_from_labels(image: LabelImage) -> list[Silhouette]:
    """Silhouettes of a caller's mask, ordered left to right by the centre of their boxes."""
    place = {"left": image.left, "top": image.top}
    people = [
        silhouette_from_mask(image.part == label, **place, segmenter="mask", truncated=False)
        for label in image.present
    ]
    found = [person for person in people if person is not None]
    flagged = with_truncation(found, [person.box for person in found], image.labels.shape)
    return sorted(
        (person for person in flagged if person is not None),
        key=lambda person: person.box.x + person.box.width / 2,
    )


# Probability from which a pixel is the person's; chosen on even-numbered photographs.
_THRESHOLD = 0.5
# Masks are drawn at no more than this height before they are cleaned.
_ROWS = 384
# Share of a pixel that the mask as drawn covers, from which the pixel is the person's.
_HALF_COVERED = 0.5
# Boxes of people cut by the frame may end this far short of its edge. The network sees better than
# the detector whether the body goes on.
_NEAR_EDGE_PX = 5.0
# Less than this share of the box, and the network did not see the person.
_LEAST_FILL = 0.12
# Landmarks seen as surely as this lie in the person's box, with this room about them.
_SEEN, _ROOM = 0.5, 0.04


def silhouettes_of(
    readings: Sequence[Reading],
    boxes: Sequence[Box],
    frame_shape: tuple[int, ...],
    *,
    exact: bool,
) -> list[Silhouette | None]:
    """Cut out people; a pixel that several claim is the surest one's.

    Parameters
    ----------
    readings : sequence of Reading
        Of all people known in the frame: each one's pixels are kept out of the others'.
    boxes : sequence of Box
        Of each.
    frame_shape : tuple of int
        Height and width first.
    exact : bool
        Whether boxes are tight about the people, else limbs may reach beyond them.

    Returns
    -------
    list of Silhouette or None
        One for each reading, in order; None where nobody could be made out.
    """
    height, width = frame_shape[:2]
    regions = [
        _region(box if exact else _with_landmarks(box, reading), width, height)
        for box, reading in zip(boxes, readings, strict=True)
    ]
    found: list[Silhouette | None] = []
    for own, region in enumerate(regions):
        rivals = [
            (readings[other], other < own)
            for other, theirs in enumerate(regions)
            if region and theirs and other != own and region.intersection(theirs) > 0
        ]
        found.append(_cut_out(readings[own], rivals, region) if region else None)
    return with_truncation(found, boxes, frame_shape)


def _with_landmarks(box: Box, reading: Reading) -> Box:
    """The box about a box and the landmarks that are seen."""
    seen = reading.landmarks.visibility >= _SEEN
    if not seen.any():
        return box
    room = _ROOM * max(box.width, box.height)
    low = reading.landmarks.positions[seen].min(axis=0) - room
    high = reading.landmarks.positions[seen].max(axis=0) + room
    left, top = min(box.x, float(low[0])), min(box.y, float(low[1]))
    return Box(
        left,
        top,
        max(box.right, float(high[0])) - left,
        max(box.bottom, float(high[1])) - top,
    )


def _region(box: Box, width: int, height: int) -> Box | None:
    """Part of the frame in which a person is cut out, moved out to edges that it nearly reaches."""
    inside = box.clip(width, height)
    if inside is None:
        return None
    left, top, _, _ = inside.pixels()
    if left >= width or top >= height:
        return None  # A sliver at the edge holds no pixel.
    sides = np.array([inside.x, inside.y, inside.right, inside.bottom])
    edges = np.array([-0.5, -0.5, width - 0.5, height - 0.5])
    near = np.abs(sides - edges) <= _NEAR_EDGE_PX
    x0, y0, x1, y1 = np.where(near, edges, sides).tolist()
    return Box(x0, y0, x1 - x0, y1 - y0)


def _cut_out(
    reading: Reading, rivals: Sequence[tuple[Reading, bool]], region: Box
) -> Silhouette | None:
    """One person's silhouette in a region; None if it is next to empty."""
    left, top, right, bottom = region.pixels()
    width, height = right - left, bottom - top
    scale = min(1.0, _ROWS / max(width, height))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    # From pixels as drawn to pixels of the frame.
    drawn = np.array(
        [
            [width / size[0], 0, left + 0.5 * width / size[0] - 0.5],
            [0, height / size[1], top + 0.5 * height / size[1] - 0.5],
        ]
    )
    own = _probability(reading, drawn, size)
    mask = own >= _THRESHOLD
    for rival, comes_first in rivals:
        theirs = _probability(rival, drawn, size)
        mask &= own > theirs if comes_first else own >= theirs
    mask = fill_small_holes(keep_components(mask, 0.1), 0.01)
    covered = cv2.resize(mask.astype(np.float32), (width, height))
    inside = covered >= _HALF_COVERED
    if np.count_nonzero(inside) < _LEAST_FILL * inside.size:
        return None
    return silhouette_from_mask(inside, left=left, top=top, segmenter="network", truncated=False)


def _probability(
    reading: Reading, drawn: NDArray[np.float64], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Probability of a reading's mask at the pixels of a region as drawn."""
    from_frame = cv2.invertAffineTransform(window_to_frame(reading.window, LANDMARK_PX))
    linear = from_frame[:, :2] @ drawn[:, :2]
    offset = from_frame[:, :2] @ drawn[:, 2] + from_frame[:, 2]
    matrix = np.column_stack([linear, offset])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(reading.probability, matrix, size, flags=flags))
