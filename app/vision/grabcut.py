"""Silhouettes by colour: GrabCut [1]_ about a detected person, without a network.

References
----------
.. [1] C. Rother, V. Kolmogorov, A. Blake, "GrabCut: interactive foreground extraction using
   iterated graph cuts", SIGGRAPH 2004.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, crop, resize
from app.vision.masks import fill_small_holes, keep_components
from app.vision.people import Silhouette, silhouette_from_mask
from app.vision.truncation import with_truncation

# Longer side at which a person is cut out: the time grows with the area.
_LARGEST_PX = 192
# The background that is learned from, around the box, as a share of its longer side.
_MARGIN = 0.15
# Probabilities of a person's pixel from which the pixel certainly, or perhaps, is the person's, and
# below which it certainly is not. Chosen on rendered people in boxes as inexact as HOG's: with
# less certainty, GrabCut keeps one garment of a person in two colours.
_SURE, _LIKELY, _NEVER = 0.8, 0.35, 0.01
_ROUNDS = 2
_MIN_PART = 0.1  # Area relative to the largest part; smaller parts are dropped.
_MAX_HOLE = 0.02  # Area relative to the mask; larger holes stay.
_MIN_FILL = 0.12  # Filled share of the box below which nobody was cut out.


def cut_out_by_colour(
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    shape: NDArray[np.floating],
    checkpoint: Callable[[], None] = lambda: None,
) -> list[Silhouette | None]:
    """Cut the person in each box out of a frame ``(H, W, 3)``, BGR; None where nobody is found.

    Parameters
    ----------
    shape : (128, 48) array
        Probability that a pixel of an upright person's normalised frame is the person's: where
        GrabCut begins.
    checkpoint : callable
        Called before each person; it raises an error if the result is not wanted.
    """
    found: list[Silhouette | None] = []
    for box in boxes:
        checkpoint()
        others = [other for other in boxes if other is not box and other.intersection(box) > 0]
        found.append(_cut_out(frame, box, others, shape))
    return with_truncation(found, boxes, frame.shape)


def _cut_out(
    frame: NDArray[np.uint8], box: Box, others: Sequence[Box], shape: NDArray[np.floating]
) -> Silhouette | None:
    region = box.grown(_MARGIN).clip(frame.shape[1], frame.shape[0])
    if region is None:
        return None
    left, top, right, bottom = region.pixels()
    right, bottom = min(right, frame.shape[1]), min(bottom, frame.shape[0])
    width, height = right - left, bottom - top
    if width < 1 or height < 1:
        return None
    factor = min(1.0, _LARGEST_PX / max(width, height))
    size = max(1, round(factor * width)), max(1, round(factor * height))
    image = resize(crop(frame, (left, top, width, height)), *size)
    own = _expected(box, shape, (left, top, width, height), size)
    labels = np.where(own >= _LIKELY, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    for other in others:
        theirs = _expected(other, shape, (left, top, width, height), size)
        labels[(theirs > own) & (theirs >= _LIKELY)] = cv2.GC_BGD
    labels[own >= _SURE] = cv2.GC_FGD
    labels[own < _NEVER] = cv2.GC_BGD
    is_person = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    if is_person.all() or not is_person.any():
        return None
    cv2.setRNGSeed(0)  # Of this thread: the same picture gets the same answer.
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(image, labels, (0, 0, *size), *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    mask = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    mask = fill_small_holes(keep_components(mask, _MIN_PART), _MAX_HOLE)
    inside = cv2.resize(mask.astype(np.float32), (width, height)) >= 0.5
    if np.count_nonzero(inside) < _MIN_FILL * box.area:
        return None
    return silhouette_from_mask(inside, left=left, top=top, segmenter="grabcut")


def _expected(
    box: Box,
    shape: NDArray[np.floating],
    region: tuple[int, int, int, int],
    size: tuple[int, int],
) -> NDArray[np.float32]:
    """Probability of a person's pixels in a region of a frame, drawn at a size ``(w, h)``.

    A person in a wide box lies, with the head on either side.
    """
    if box.width > box.height:
        lying = np.rot90(shape)
        shape = (lying + lying[:, ::-1]) / 2
    rows, columns = shape.shape
    # An upright person's shape is as high as the box, a lying one's as wide.
    scale = box.width / columns if box.width > box.height else box.height / rows
    left, top, width, height = region
    steps = np.array([width, height]) / size
    # From pixels as drawn to pixels of the shape; both middles coincide.
    corner = np.array([left, top]) + 0.5 * steps - 0.5
    middle = np.array([box.x + box.width / 2, box.y + box.height / 2])
    offset = (corner - middle) / scale + (np.array([columns, rows]) - 1) / 2
    matrix = np.column_stack([np.diag(steps / scale), offset])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(shape.astype(np.float32), matrix, size, flags=flags))
