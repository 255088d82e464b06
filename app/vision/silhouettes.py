"""Silhouettes of people: by the network's masks, a caller's mask or background, or colour [1]_.

References
----------
.. [1] C. Rother, V. Kolmogorov, A. Blake, "GrabCut: interactive foreground extraction using
   iterated graph cuts", SIGGRAPH 2004.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import Box, crop, resize, shrink_quickly
from app.vision.masks import MIN_FILL, LabelImage, cleaned
from app.vision.people import (
    Detection,
    SegmenterName,
    Silhouette,
    landmark_rows,
    silhouette_from_mask,
)
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
        found.append(_cut_by_mask(readings[own], rivals, region) if region else None)
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


def _with_landmarks(box: Box, reading: PoseReading) -> Box:
    """A box widened to the visible landmarks and, where the ears are visible, to the crown."""
    visible = reading.landmarks.visibility >= 0.5
    if not visible.any():
        return box
    positions = reading.landmarks.positions[visible]
    if visible[_EARS].all() and visible[_SHOULDERS].all():
        ears, shoulders = (
            reading.landmarks.positions[rows].mean(0) for rows in (_EARS, _SHOULDERS)
        )
        # Distance from the ears to the crown, relative to that from the shoulders to the ears.
        positions = np.vstack([positions, ears + 0.7 * (ears - shoulders)])
    margin = 0.04 * max(box.width, box.height)
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


def _cut_by_mask(
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
    mask = own >= 0.5  # Chosen on even-numbered photographs.
    for rival, wins_ties in rivals:
        theirs = _probability(rival, to_frame, size)
        mask &= own > theirs if wins_ties else own >= theirs
    mask = cleaned(mask, max_hole=0.01)
    return _enlarged(mask, (left, top, width, height), width * height, "network")


def _enlarged(
    mask: NDArray[np.bool_],
    region: tuple[int, int, int, int],
    box_area: float,
    segmenter: SegmenterName,
) -> Silhouette | None:
    """The silhouette of a mask that was drawn smaller over a region of the frame.

    None if it fills too little of the person's box.
    """
    left, top, width, height = region
    # Least share of a person's pixel that the drawn mask covers.
    inside = cv2.resize(mask.astype(np.float32), (width, height)) >= 0.5
    if np.count_nonzero(inside) < MIN_FILL * box_area:
        return None
    return silhouette_from_mask(inside, left=left, top=top, segmenter=segmenter)


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


def foreground(frame: NDArray[np.uint8], background: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels ``(H, W)`` that changed by more than exposure, noise and shadow explain.

    OpenCV's mixture of Gaussians (Zivkovic, 2004) learns the background as one picture, in the
    exposure of the frame. Both are ``(H, W, 3)``, BGR; ``ValueError`` if their shapes differ.
    """
    if frame.shape != background.shape:
        raise ValueError(f"expected a background of shape {frame.shape}, got {background.shape}")
    height, width = frame.shape[:2]
    # Larger frames are reduced, since a pixel takes 60 bytes.
    factor = min(1.0, (1920 * 1080 / (height * width)) ** 0.5)
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
    # The exposure changes by at most one f-stop, either way.
    gain = float(np.clip(up / max(along, 1e-6), 0.5, 2.0))
    levels = y + (np.arange(256) - x) * gain
    return np.asarray(cv2.LUT(scene, levels.clip(0, 255).round().astype(np.uint8)), np.uint8)


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
        # Width of an upright person, relative to the height.
        if height >= min_person_px and 0.15 <= width / height <= 1.2:
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
_LIKELY = 0.35  # Probability from which a pixel is perhaps the person's.


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
        found.append(_cut_by_colour(frame, box, others, shape))
    return with_truncation(found, boxes, frame.shape)


def _cut_by_colour(
    frame: NDArray[np.uint8], box: Box, others: Sequence[Box], shape: NDArray[np.floating]
) -> Silhouette | None:
    region = box.grown(0.15).clip(frame.shape[1], frame.shape[0])
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
    # Chosen on rendered people in boxes as inexact as HOG's, as is what is likely: with less
    # certainty, GrabCut keeps one garment of a person in two colours.
    labels[own >= 0.8] = cv2.GC_FGD
    labels[own < 0.01] = cv2.GC_BGD
    is_person = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    if is_person.all() or not is_person.any():
        return None
    cv2.setRNGSeed(0)  # Of this thread: the same picture gets the same answer.
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(image, labels, (0, 0, *size), *models, 2, cv2.GC_INIT_WITH_MASK)
    mask = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
    mask = cleaned(mask, max_hole=0.02)
    return _enlarged(mask, (left, top, width, height), box.area, "grabcut")


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
