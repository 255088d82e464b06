"""Silhouettes of people, as the differences from a picture of the empty scene."""

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, shrink_quickly
from app.vision.images import turn_of
from app.vision.masks import fill_small_holes, keep_components
from app.vision.people import Detection, Silhouette, silhouette_from_mask
from app.vision.truncation import with_truncation

_MIN_HEIGHT_SHARE = 0.8  # Height of a region, relative to the smallest person wanted.
_HEIGHT_PER_GAP = 12.0  # Height of that person relative to gaps closed within a body.
_MIN_PART = 0.1  # Area relative to the largest part; smaller parts are dropped.
_MAX_HOLE = 0.05  # Area relative to the mask; larger holes stay.


class BackgroundSegmenter:
    """Cuts people out by their difference from a picture of the empty scene.

    The picture ``(H, W, 3)``, BGR, is from the same fixed camera; the smallest person wanted is
    ``min_person_px`` high. The difference is kept for further calls with the same frame.
    """

    def __init__(self, background: NDArray[np.uint8], *, min_person_px: float = 50) -> None:
        self._background = background
        self._min_person_px = min_person_px
        self._compared: tuple[NDArray[np.uint8], NDArray[np.bool_]] | None = None

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find people as upright regions of change.

        The score, at most 0.9, says how much a region's size, proportions and solidity resemble a
        person; the best comes first. People who touch in the frame are found as one.

        Raises
        ------
        ValueError
            If the frame ``(H, W, 3)`` does not have the size of the background.
        """
        min_height = _MIN_HEIGHT_SHARE * self._min_person_px
        rows, columns = frame.shape[:2]
        is_too_thin = rows < min_height or columns < _ASPECT[0] * min_height
        if is_too_thin and frame.shape == self._background.shape:
            return []
        step = math.ceil(math.sqrt(rows * columns / MAX_PX))
        changed = self._changed(frame)[::step, ::step]
        # Closing joins the parts of a body, for example if its belt has the pavement's colour.
        reach = max(1, round(self._min_person_px / step / _HEIGHT_PER_GAP))
        kernel: NDArray[np.uint8] = np.ones((2 * reach + 1, 3), np.uint8)
        joined = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
        found = []
        high = np.flatnonzero(stats[1:count, cv2.CC_STAT_HEIGHT] >= min_height / step) + 1
        for label, (left, top, width, height, _) in zip(high, stats[high].tolist(), strict=True):
            part = np.s_[top : top + height, left : left + width]
            own = changed[part] & (labels[part] == label)
            score = _likeness(width / height, float(own.mean()))
            if score > 0:
                box = Box(step * left - 0.5, step * top - 0.5, step * width, step * height)
                found.append(Detection(box, score))
        return sorted(found, key=lambda one: -one.score)

    def segment(
        self,
        frame: NDArray[np.uint8],
        boxes: Sequence[Box],
        checkpoint: Callable[[], None] = lambda: None,
    ) -> list[Silhouette | None]:
        """Cut out the person in each box of a frame ``(H, W, 3)``; None where nothing changed.

        Where boxes overlap, a pixel goes to the box whose middle is nearer, in widths of the boxes.
        ``checkpoint`` is called before each person; it raises an error if the work is no longer
        wanted.
        """
        height, width = frame.shape[:2]
        changed = self._changed(frame)
        found: list[Silhouette | None] = []
        for row, whole in enumerate(boxes):
            checkpoint()
            box = whole.clip(width, height)
            if box is None:
                found.append(None)
                continue
            left, top, right, bottom = box.pixels()
            mask = changed[top:bottom, left:right].copy()
            for other in (*boxes[:row], *boxes[row + 1 :]):
                if box.intersection(other) > 0:
                    mask &= ~_nearer_to_other(box, other, mask.shape)
            mask = fill_small_holes(keep_components(mask, _MIN_PART), _MAX_HOLE)
            found.append(silhouette_from_mask(mask, left=left, top=top, segmenter="background"))
        return with_truncation(found, boxes, frame.shape)

    def _changed(self, frame: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Pixels ``(H, W)`` that differ from the scene."""
        compared = self._compared
        if compared is None or compared[0] is not frame:
            with turn_of(frame.shape[0] * frame.shape[1]):
                changed = foreground(frame, self._background)
            compared = self._compared = frame, changed
        return compared[1]


MAX_PX = 1920 * 1080
"""Larger frames are reduced: one of 12 megapixels took 13 s and 2 GB."""

_REDUCED = 2 / 3  # Their sides then, relative to the largest: comparing takes 70 bytes a pixel.
_BLUR_PX = 0.8  # Standard deviation of the blur before frames are compared.
# Difference, in standard deviations of the noise, from which a pixel has certainly changed, and
# from which a pixel connected to such a one has changed.
_CERTAIN_DISTANCE = 8.0
_POSSIBLE_DISTANCE = 4.0


def foreground(frame: NDArray[np.uint8], background: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels that differ from the background by more than exposure, noise and shadow explain.

    Exposure is a gain and an offset for each channel, fitted to the pixels that agree; the noise is
    estimated from what remains. A shadow dims all channels alike and evenly.

    Both pictures are ``(H, W, 3)``, BGR; ``ValueError`` if their shapes differ.
    """
    if frame.shape != background.shape:
        raise ValueError(f"expected a background of shape {frame.shape}, got {background.shape}")
    height, width = frame.shape[:2]
    if height * width > MAX_PX:
        factor = _REDUCED * math.sqrt(MAX_PX / (height * width))
        size = max(1, int(factor * width)), max(1, int(factor * height))
        reduced = foreground(shrink_quickly(frame, *size), shrink_quickly(background, *size))
        return cv2.resize(
            reduced.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
        ).view(np.bool_)
    now, scene = (
        cv2.GaussianBlur(image, (0, 0), _BLUR_PX).astype(np.float32)
        for image in (frame, background)
    )
    expected = _with_exposure_of(now, scene)
    distance, difference = _distances(now, expected)
    distance[_shadow(now, expected)] = 0
    grown = _hysteresis(distance > _POSSIBLE_DISTANCE, distance > _CERTAIN_DISTANCE)
    opened = cv2.morphologyEx(grown.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return _without_halo(closed > 0, difference)


def _with_exposure_of(now: NDArray[np.float32], scene: NDArray[np.float32]) -> NDArray[np.float32]:
    """The scene ``(H, W, 3)``, adapted in place to the exposure of this frame."""
    for channel in range(3):
        x, y = scene[::4, ::4, channel].ravel(), now[::4, ::4, channel].ravel()
        gain, offset = _fit_exposure(x, y)
        scene[..., channel] = gain * scene[..., channel] + offset
    return np.clip(scene, 1, 255, out=scene)


_EXPOSURE_RANGE = (4.0, 250.0)  # Grey levels outside are not used to fit it.
_MIN_EXPOSURE_SAMPLES = 100
# The fit is repeated on the samples whose error is within this multiple of the median error, or
# within this many grey levels: people are outliers.
_EXPOSURE_ROUNDS = 4
_EXPOSURE_OUTLIER = 2.5
_MIN_EXPOSURE_ERROR = 3.0


def _fit_exposure(x: NDArray[np.float32], y: NDArray[np.float32]) -> tuple[float, float]:
    """Gain and offset from samples ``(N,)`` of the scene to those of the frame."""
    low, high = _EXPOSURE_RANGE
    usable = (x > low) & (x < high) & (y > low) & (y < high)
    if np.count_nonzero(usable) < _MIN_EXPOSURE_SAMPLES:
        return 1.0, 0.0
    x, y = x[usable], y[usable]
    gain, offset = float(np.median(y / x)), 0.0
    # People are outliers: the fit is repeated on the samples that agree with it.
    for _ in range(_EXPOSURE_ROUNDS):
        error = np.abs(y - gain * x - offset)
        limit = _EXPOSURE_OUTLIER * float(np.median(error))
        agree = error <= max(_MIN_EXPOSURE_ERROR, limit)
        centre_x, centre_y = float(x[agree].mean()), float(y[agree].mean())
        spread = float(((x[agree] - centre_x) ** 2).sum())
        if spread < 1:
            break
        gain = float(((x[agree] - centre_x) * (y[agree] - centre_y)).sum()) / spread
        offset = centre_y - gain * centre_x
    return gain, offset


_MIN_NOISE = 2.0  # Grey levels: compression alone leaves this much.
# Share of the background's local contrast that counts as noise: vibration and focus breathing move
# edges.
_CONTRAST_NOISE = 0.25


def _distances(
    now: NDArray[np.float32], expected: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distances ``(H, W)`` in standard deviations of the noise, and the largest difference."""
    squares = np.zeros(now.shape[:2], np.float32)
    difference = np.zeros(now.shape[:2], np.float32)
    # Working channel by channel takes a third of the memory.
    for channel in range(3):
        residual = np.abs(now[..., channel] - expected[..., channel])
        # A normal distribution's standard deviation is 1.4826 times its median deviation.
        noise = max(1.4826 * float(np.median(residual[::2, ::2])), _MIN_NOISE)
        contrast = cv2.morphologyEx(
            expected[..., channel], cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)
        )
        squares += residual**2 / (noise**2 + (_CONTRAST_NOISE * contrast) ** 2)
        np.maximum(difference, residual, out=difference)
    return np.sqrt(squares / 3), difference


# A shadow leaves a share of the light in this range, alike in all channels, and the texture.
_SHADOW_LIGHT = (0.45, 0.98)
_MAX_SHADOW_TINT = 0.06
_MAX_SHADOW_UNEVENNESS = 0.05


def _shadow(now: NDArray[np.float32], expected: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels ``(H, W)`` where the scene has less light: equally in all channels, and evenly."""
    # Adding channel by channel takes a quarter of the time of sums along the last axis.
    total_now = now[..., 0] + now[..., 1] + now[..., 2]
    total_expected = expected[..., 0] + expected[..., 1] + expected[..., 2]
    light = total_now / total_expected
    total_now = np.maximum(total_now, 1)
    tint = np.zeros_like(light)
    for channel in range(3):
        share = now[..., channel] / total_now
        share -= expected[..., channel] / total_expected
        np.maximum(tint, np.abs(share, out=share), out=tint)
    mean = cv2.blur(light, (5, 5))
    unevenness = np.sqrt(np.maximum(cv2.blur(light**2, (5, 5)) - mean**2, 0))
    darkest, brightest = _SHADOW_LIGHT
    return (
        (light > darkest)
        & (light < brightest)
        & (tint < _MAX_SHADOW_TINT)
        & (unevenness < _MAX_SHADOW_UNEVENNESS)
    )


def _hysteresis(possible: NDArray[np.bool_], certain: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The connected parts of ``possible`` that include a pixel of ``certain``."""
    count, labels = cv2.connectedComponents(possible.astype(np.uint8))
    chosen = np.bincount(labels[certain & possible], minlength=count) > 0
    chosen[0] = False
    return chosen[labels]


_MIN_COVER = 0.45  # Share of the nearby difference that half a pixel of a person shows.


def _without_halo(mask: NDArray[np.bool_], difference: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Drop border pixels that a person covers by less than half, since lenses blur edges.

    Such pixels differ from the background less than half as much as pixels further inside.
    """
    kernel: NDArray[np.uint8] = np.ones((5, 5), np.uint8)
    inside = cv2.erode(mask.astype(np.uint8), kernel, borderValue=1) > 0
    strongest = cv2.dilate(np.where(mask, difference, 0).astype(np.float32), kernel)
    return inside | (mask & (difference > _MIN_COVER * strongest))


# Scores of a region, as a standing or walking body: by its width over height, 0 outside the range,
# and by the share of its box that it fills, 0 below the range.
_ASPECT = (0.15, 0.25, 0.6, 1.2)
_ASPECT_SCORE = (0.3, 1.0, 1.0, 0.2)
_FILL = (0.2, 0.4)
_FILL_SCORE = (0.4, 1.0)
_MAX_SCORE = 0.9  # A region of change is never a person for certain.


def _likeness(aspect: float, fill: float) -> float:
    """How much a region's proportions and solidity resemble an upright body."""
    if not _ASPECT[0] <= aspect <= _ASPECT[-1] or fill < _FILL[0]:
        return 0.0
    upright = float(np.interp(aspect, _ASPECT, _ASPECT_SCORE))
    solid = float(np.interp(fill, _FILL, _FILL_SCORE))
    return _MAX_SCORE * upright * solid


def _nearer_to_other(box: Box, other: Box, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels of ``box``, of this shape, that also lie in ``other`` and are nearer its middle."""
    left, top, _, _ = box.pixels()
    x, y = left + np.arange(shape[1]), top + np.arange(shape[0])
    inside_x = (x >= other.x) & (x <= other.right)
    inside_y = (y >= other.y) & (y <= other.bottom)
    own = np.abs(x - box.x - box.width / 2) / box.width
    theirs = np.abs(x - other.x - other.width / 2) / other.width
    return inside_y[:, None] & (inside_x & (theirs < own))[None, :]
