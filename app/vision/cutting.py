"""Silhouettes without a network: what differs from a background, or by colour.

References
----------
.. [1] C. Rother, V. Kolmogorov, A. Blake, "GrabCut: interactive foreground extraction using
   iterated graph cuts", SIGGRAPH 2004.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, crop, resize, shrink_quickly
from app.vision.masks import MIN_FILL, cleaned
from app.vision.people import Detection, Silhouette, silhouette_from_mask
from app.vision.truncation import with_truncation

_MAX_PX = 1920 * 1080  # Larger frames are reduced, since a pixel takes 60 bytes.
_MAX_GAIN = 2.0  # Largest change of exposure, either way: one f-stop.


def foreground(frame: NDArray[np.uint8], background: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels ``(H, W)`` that changed by more than exposure, noise and shadow explain.

    OpenCV's mixture of Gaussians (Zivkovic, 2004) learns the background as one picture, in the
    exposure of the frame. Both are ``(H, W, 3)``, BGR; ``ValueError`` if their shapes differ.
    """
    if frame.shape != background.shape:
        raise ValueError(f"expected a background of shape {frame.shape}, got {background.shape}")
    height, width = frame.shape[:2]
    factor = min(1.0, (_MAX_PX / (height * width)) ** 0.5)
    size = max(1, int(factor * width)), max(1, int(factor * height))
    now, scene = (
        np.asarray(cv2.medianBlur(shrink_quickly(image, *size), 3), np.uint8)
        for image in (frame, background)
    )
    scene = np.dstack([_in_exposure(scene[..., k], now[..., k]) for k in range(3)])
    # A normal distribution's standard deviation is 1.4826 times its median deviation.
    # Grey levels that compression and vibration leave; chosen on people pasted into a street.
    noise = max(4.0, 1.4826 * float(np.median(cv2.absdiff(now, scene)[::2, ::2])))
    model = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
    model.setNMixtures(1)
    for set_variance in (model.setVarInit, model.setVarMin, model.setVarMax):
        set_variance(noise**2)
    model.apply(scene, learningRate=1.0)
    changed = np.asarray(model.apply(now, learningRate=0.0) == 255).view(np.uint8)
    speck: NDArray[np.uint8] = np.ones((3, 3), np.uint8)
    opened = cv2.morphologyEx(changed, cv2.MORPH_OPEN, speck)
    return cv2.resize(opened, (width, height), interpolation=cv2.INTER_NEAREST) > 0


def _in_exposure(scene: NDArray[np.uint8], now: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """One channel ``(H, W)`` of the scene in a frame's exposure, a gain and an offset.

    They are a line through the pixels of both, fitted so that people count little.
    """
    pairs = np.column_stack([scene[::12, ::12].ravel(), now[::12, ::12].ravel()]).astype(np.float32)
    along, up, x, y = cv2.fitLine(pairs, cv2.DIST_HUBER, 0, 0.01, 0.01).ravel().tolist()
    # If the scene has no contrast, the line may be steep.
    gain = float(np.clip(up / max(along, 1e-6), 1 / _MAX_GAIN, _MAX_GAIN))
    levels = y + (np.arange(256) - x) * gain
    return np.asarray(cv2.LUT(scene, levels.clip(0, 255).round().astype(np.uint8)), np.uint8)


_WIDTHS = (0.15, 1.2)  # Of an upright person, relative to the height.


def upright_regions(changed: NDArray[np.bool_], min_person_px: float) -> list[Detection]:
    """People as upright regions of a foreground, the most solid ones first.

    The score is at most 0.9, since a region of change is never certain to be a person. People
    touching in the frame are found as one.
    """
    # Closing joins the parts of a body, for example if its belt has the pavement's colour.
    # Height of a person relative to gaps closed within a body.
    reach = max(1, round(min_person_px / 12.0))
    gap: NDArray[np.uint8] = np.ones((2 * reach + 1, 3), np.uint8)
    joined = cv2.morphologyEx(changed.view(np.uint8), cv2.MORPH_CLOSE, gap)
    found = []
    for left, top, width, height, area in cv2.connectedComponentsWithStats(joined)[2][1:].tolist():
        box = Box(left - 0.5, top - 0.5, width, height)
        if height >= min_person_px and _WIDTHS[0] <= width / height <= _WIDTHS[1]:
            # Share of the box that a body fills.
            found.append(Detection(box, 0.9 * min(1.0, area / (0.4 * box.area))))
    return sorted(found, key=lambda one: -one.score)


def cut_out_changed(
    changed: NDArray[np.bool_],
    boxes: Sequence[Box],
    checkpoint: Callable[[], None] = lambda: None,
) -> list[Silhouette | None]:
    """Cut the person in each box out of a foreground; None where nothing changed.

    A pixel in several boxes goes to the one whose middle is nearest, in widths of the boxes.
    ``checkpoint`` is called before each person; it raises an error if the result is not wanted.
    """
    found: list[Silhouette | None] = []
    for whole in boxes:
        checkpoint()
        box = whole.clip(changed.shape[1], changed.shape[0])
        if box is None:
            found.append(None)
            continue
        left, top, right, bottom = box.pixels()
        y, x = np.ogrid[top:bottom, left:right]
        mask = changed[top:bottom, left:right].copy()
        for other in (one for one in boxes if one.intersection(box) > 0):
            inside = (x >= other.x) & (x <= other.right) & (y >= other.y) & (y <= other.bottom)
            own, theirs = (abs(x - one.x - one.width / 2) / one.width for one in (whole, other))
            mask &= ~(inside & (theirs < own))
        mask = cleaned(mask, max_hole=0.05)
        found.append(silhouette_from_mask(mask, left=left, top=top, segmenter="background"))
    return with_truncation(found, boxes, changed.shape)


# Longer side at which a person is cut out: the time grows with the area.
_LARGEST_PX = 192
# The background that is learned from, around the box, as a share of its longer side.
_MARGIN = 0.15
# Probabilities of a person's pixel from which the pixel certainly, or perhaps, is the person's, and
# below which it certainly is not. Chosen on rendered people in boxes as inexact as HOG's: with
# less certainty, GrabCut keeps one garment of a person in two colours.
_SURE, _LIKELY, _NEVER = 0.8, 0.35, 0.01
_ROUNDS = 2


def cut_out_by_colour(
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    shape: NDArray[np.floating],
    checkpoint: Callable[[], None] = lambda: None,
) -> list[Silhouette | None]:
    """Cut the person in each box out of a frame ``(H, W, 3)``, BGR, by GrabCut [1]_.

    None stands for boxes in which nobody is found.

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
    mask = cleaned(mask, max_hole=0.02)
    inside = cv2.resize(mask.astype(np.float32), (width, height)) >= 0.5
    if np.count_nonzero(inside) < MIN_FILL * box.area:
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
