"""Silhouettes without a network: GrabCut, started from a body-shaped prior."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.body_shape import body_prior
from app.vision.mask_cleaning import fill_small_holes, keep_components
from app.vision.people import Box, SegmenterName, Silhouette, silhouette_from_mask
from app.vision.resampling import cut, resize, resize_mask
from app.vision.truncation import with_truncation

# Bodies are cut out at this height: GrabCut's time grows with the pixels, its colour models
# need no more.
_ROWS = 160
_ITERATIONS = 3
# Room around the box, in box heights, from which the background's colours are learnt.
_MARGIN = 0.12


class GrabCutSegmenter:
    """Cut people out by colour alone; needs no model file, holds no state."""

    name: SegmenterName = "grabcut"

    def segment(self, frame: NDArray[np.uint8], boxes: Sequence[Box]) -> list[Silhouette | None]:
        """Cut out the person in each box; see :class:`app.vision.segment.Segmenter`."""
        height, width = frame.shape[:2]
        found: list[Silhouette | None] = []
        for index, whole in enumerate(boxes):
            box = whole.clip(width, height)
            others = [other for i, other in enumerate(boxes) if i != index]
            found.append(None if box is None else _cut_out(frame, box, others))
        return with_truncation(found, boxes, frame.shape)


def _cut_out(frame: NDArray[np.uint8], box: Box, others: Sequence[Box]) -> Silhouette | None:
    left, top, right, bottom = box.pixels()
    margin = max(2, round(_MARGIN * (bottom - top)))
    window = (left - margin, top - margin, right - left + 2 * margin, bottom - top + 2 * margin)
    scale = min(1.0, _ROWS / (bottom - top))
    size = (max(8, round(window[2] * scale)), max(8, round(window[3] * scale)))
    image = resize(cut(frame, window), *size)
    x0, y0 = round(margin * scale), round(margin * scale)
    rows, columns = max(1, size[1] - 2 * y0), max(1, size[0] - 2 * x0)
    prior = body_prior(rows, columns)
    for other in others:
        _lower_where_others_stand(prior, box, other)
    labels = np.full(size[::-1], cv2.GC_BGD, np.uint8)
    inner = labels[y0 : y0 + rows, x0 : x0 + columns]
    inner[:] = np.where(prior > 0.5, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    inner[prior < 0.06] = cv2.GC_BGD
    inner[prior > 0.95] = cv2.GC_FGD
    if not (labels == cv2.GC_BGD).any() or not (labels & 1).any():
        return None
    # Repeatable: GrabCut seeds its colour clusters from OpenCV's random numbers.
    cv2.setRNGSeed(0)
    try:
        empty: NDArray[np.float64] = np.zeros((1, 65))
        models = (empty, empty.copy())
        image = np.ascontiguousarray(image)
        cv2.grabCut(image, labels, (0, 0, 0, 0), *models, _ITERATIONS, cv2.GC_INIT_WITH_MASK)
    except cv2.error:  # a crop of one colour has no two colour models
        return None
    mask = fill_small_holes(keep_components((labels & 1) == 1, 0.2), 0.02)
    whole = resize_mask(mask, window[2], window[3])
    inside = whole[margin : margin + bottom - top, margin : margin + right - left]
    return silhouette_from_mask(inside, left=left, top=top, segmenter="grabcut", truncated=False)


def _lower_where_others_stand(prior: NDArray[np.float32], box: Box, other: Box) -> None:
    """Halve the odds of pixels that lie nearer to another person's axis, in place."""
    if box.intersection(other) == 0:
        return
    rows, columns = prior.shape
    x = box.x + (np.arange(columns) + 0.5) * box.width / columns
    y = box.y + (np.arange(rows) + 0.5) * box.height / rows
    nearer = np.abs(x - other.x - other.width / 2) < np.abs(x - box.x - box.width / 2)
    beside = (y >= other.y) & (y <= other.bottom)
    prior[np.ix_(beside, nearer)] = np.minimum(prior[np.ix_(beside, nearer)], 0.3)
