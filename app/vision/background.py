"""People as what differs from a picture of the empty scene."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, Detection, SegmenterName, Silhouette, silhouette_from_mask
from app.vision.silhouettes import fill_small_holes, keep_components
from app.vision.truncation import with_truncation
from app.vision.windows import resize

# Differences in standard deviations of the noise: certainly changed, and changed if connected
# to something that certainly is.
_SURE = 8.0
_MAYBE = 4.0
# Grey levels; compression alone leaves this much.
_LEAST_NOISE = 2.0
# Share of the background's local contrast that counts as noise: a lens breathes, a mast sways.
_SWAY = 0.25
# A shadow dims all channels alike, down to this share of the light, and leaves the texture.
_DEEPEST_SHADOW = 0.45
_SHADOW_TINT = 0.06
_SHADOW_UNEVENNESS = 0.05
# Share of the nearby difference that a pixel half covered by the person shows.
_HALF_COVERED = 0.45
# Larger frames are compared at this size: one of 12 megapixels took 13 s and 2 GB.
_MOST_PIXELS = 1920 * 1080
# A standing or walking body: width over height, and how much of its box it fills.
_ASPECTS = (0.15, 1.2)
_LEAST_FILL = 0.2


class BackgroundSegmenter:
    """Cut people out by their difference from the empty scene.

    What differs in a frame is kept for the next question about the same frame.

    Parameters
    ----------
    background : (H, W, 3) uint8 array
        BGR picture of the empty scene by the same fixed camera.
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    """

    name: SegmenterName = "background"

    def __init__(self, background: NDArray[np.uint8], *, min_person_px: float = 50) -> None:
        self._background = background
        self._min_person_px = min_person_px
        self._compared: tuple[NDArray[np.uint8], NDArray[np.bool_]] | None = None

    def detect(self, frame: NDArray[np.uint8]) -> list[Detection]:
        """Find people as upright regions of change.

        Regions are not people for certain: the score, at most 0.9, is how much their size,
        proportions and solidity resemble one. People who touch in the frame come as one.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR, of the background's size.

        Returns
        -------
        list of Detection
            Best first.

        Raises
        ------
        ValueError
            If the sizes of frame and background differ.
        """
        least_px = 0.8 * self._min_person_px
        rows, columns = frame.shape[:2]
        too_thin = rows < least_px or columns < _ASPECTS[0] * least_px
        if too_thin and frame.shape == self._background.shape:
            return []
        changed = self._changed(frame)
        reach = max(1, round(self._min_person_px / 12))
        # Joins the parts of a body whose belt has the pavement's colour.
        kernel: NDArray[np.uint8] = np.ones((2 * reach + 1, 3), np.uint8)
        joined = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
        found = []
        for label, (left, top, width, height, _) in enumerate(stats[1:count].tolist(), start=1):
            if height < least_px:
                continue
            part = np.s_[top : top + height, left : left + width]
            own = changed[part] & (labels[part] == label)
            score = _likeness(width / height, float(own.mean()))
            if score > 0:
                found.append(Detection(Box(left - 0.5, top - 0.5, width, height), score))
        return sorted(found, key=lambda one: -one.score)

    def segment(self, frame: NDArray[np.uint8], boxes: Sequence[Box]) -> list[Silhouette | None]:
        """Cut out the person in each box; None where nobody is.

        Where boxes overlap, a changed pixel goes to the box whose middle is nearer, in widths.
        """
        height, width = frame.shape[:2]
        changed = self._changed(frame)
        found: list[Silhouette | None] = []
        for index, whole in enumerate(boxes):
            box = whole.clip(width, height)
            if box is None:
                found.append(None)
                continue
            left, top, right, bottom = box.pixels()
            mask = changed[top:bottom, left:right].copy()
            for other in (b for i, b in enumerate(boxes) if i != index):
                mask &= ~_nearer_to_other(box, other, mask.shape)
            mask = fill_small_holes(keep_components(mask, 0.1), 0.05)
            found.append(
                silhouette_from_mask(
                    mask, left=left, top=top, segmenter="background", truncated=False
                )
            )
        return with_truncation(found, boxes, frame.shape)

    def _changed(self, frame: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Pixels ``(H, W)`` that differ from the scene."""
        compared = self._compared
        if compared is None or compared[0] is not frame:
            compared = self._compared = frame, foreground(frame, self._background)
        return compared[1]


def foreground(frame: NDArray[np.uint8], background: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels that differ from the background by more than exposure, noise and shadow explain.

    Exposure is a gain and an offset for each channel, fitted to the pixels that agree; noise
    is what is left of them. A shadow is where all channels are dimmed alike and evenly.

    Parameters
    ----------
    frame, background : (H, W, 3) uint8 array
        BGR, of one size.

    Returns
    -------
    (H, W) bool array

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    if frame.shape != background.shape:
        raise ValueError(f"expected a background of shape {frame.shape}, got {background.shape}")
    height, width = frame.shape[:2]
    if height * width > _MOST_PIXELS:
        factor = math.sqrt(_MOST_PIXELS / (height * width))
        size = max(1, int(factor * width)), max(1, int(factor * height))
        reduced = foreground(resize(frame, *size), resize(background, *size))
        return cv2.resize(
            reduced.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
        ).view(np.bool_)
    now = cv2.GaussianBlur(frame, (0, 0), 0.8).astype(np.float32)
    expected = _exposed_alike(now, cv2.GaussianBlur(background, (0, 0), 0.8).astype(np.float32))
    squares = np.zeros((height, width), np.float32)
    difference = np.zeros((height, width), np.float32)
    # Channel by channel, which takes a third of the memory.
    for channel in range(3):
        residual = np.abs(now[..., channel] - expected[..., channel])
        noise = max(1.4826 * float(np.median(residual[::2, ::2])), _LEAST_NOISE)
        contrast = cv2.morphologyEx(
            expected[..., channel], cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)
        )
        squares += residual**2 / (noise**2 + (_SWAY * contrast) ** 2)
        np.maximum(difference, residual, out=difference)
    distance = np.sqrt(squares / 3)
    distance[_shadow(now, expected)] = 0
    grown = _hysteresis(distance > _MAYBE, distance > _SURE)
    opened = cv2.morphologyEx(grown.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return _without_halo(closed > 0, difference)


def _without_halo(mask: NDArray[np.bool_], difference: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Drop border pixels that the person covers by less than half, as lenses blur edges.

    There, the difference is less than about half of what it is further inside.
    """
    kernel: NDArray[np.uint8] = np.ones((5, 5), np.uint8)
    inside = cv2.erode(mask.astype(np.uint8), kernel, borderValue=1) > 0
    strongest = cv2.dilate(np.where(mask, difference, 0).astype(np.float32), kernel)
    return np.asarray(inside | (mask & (difference > _HALF_COVERED * strongest)))


def _exposed_alike(now: NDArray[np.float32], scene: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scene as this frame's exposure would show it, ``(H, W, 3)``."""
    result = np.empty_like(scene)
    for channel in range(3):
        x, y = scene[::4, ::4, channel].ravel(), now[::4, ::4, channel].ravel()
        usable = (x > 4) & (x < 250) & (y > 4) & (y < 250)
        if np.count_nonzero(usable) < 100:
            result[..., channel] = scene[..., channel]
            continue
        x, y = x[usable], y[usable]
        gain, offset = float(np.median(y / x)), 0.0
        for _ in range(4):  # people are outliers: fit to what agrees, again and again
            error = np.abs(y - gain * x - offset)
            agree = error <= max(3.0, 2.5 * float(np.median(error)))
            centre_x, centre_y = float(x[agree].mean()), float(y[agree].mean())
            spread = float(((x[agree] - centre_x) ** 2).sum())
            if spread < 1:
                break
            slope = float(((x[agree] - centre_x) * (y[agree] - centre_y)).sum()) / spread
            gain, offset = slope, centre_y - slope * centre_x
        result[..., channel] = gain * scene[..., channel] + offset
    return np.clip(result, 1, 255, out=result)


def _shadow(now: NDArray[np.float32], expected: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Where the scene is seen with less light: equally in all channels, and evenly."""
    # Channel by channel, which takes a quarter of the time of sums along the last axis.
    channels = range(3)
    total_now = now[..., 0] + now[..., 1] + now[..., 2]
    total_expected = expected[..., 0] + expected[..., 1] + expected[..., 2]
    light = total_now / total_expected
    total_now = np.maximum(total_now, 1)
    tint = np.maximum.reduce(
        [np.abs(now[..., c] / total_now - expected[..., c] / total_expected) for c in channels]
    )
    mean = cv2.blur(light, (5, 5))
    unevenness = np.sqrt(np.maximum(cv2.blur(light**2, (5, 5)) - mean**2, 0))
    dimmed = (light > _DEEPEST_SHADOW) & (light < 0.98)
    return np.asarray(dimmed & (tint < _SHADOW_TINT) & (unevenness < _SHADOW_UNEVENNESS))


def _hysteresis(maybe: NDArray[np.bool_], sure: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the connected parts of ``maybe`` that hold a pixel of ``sure``."""
    count, labels = cv2.connectedComponents(maybe.astype(np.uint8))
    chosen = np.bincount(labels[sure & maybe], minlength=count) > 0
    chosen[0] = False
    return np.asarray(chosen[labels])


def _likeness(aspect: float, fill: float) -> float:
    """How much a region's proportions and solidity resemble an upright body, 0 to 0.9."""
    if not (_ASPECTS[0] <= aspect <= _ASPECTS[1]) or fill < _LEAST_FILL:
        return 0.0
    upright = float(np.interp(aspect, (0.15, 0.25, 0.6, 1.2), (0.3, 1, 1, 0.2)))
    solid = float(np.interp(fill, (0.2, 0.4), (0.4, 1)))
    return 0.9 * upright * solid


def _nearer_to_other(box: Box, other: Box, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels of ``box`` that lie in ``other`` too and nearer its vertical axis."""
    left, top, _, _ = box.pixels()
    x, y = left + np.arange(shape[1]), top + np.arange(shape[0])
    inside_x = (x >= other.x) & (x <= other.right)
    inside_y = (y >= other.y) & (y <= other.bottom)
    own = np.abs(x - box.x - box.width / 2) / box.width
    theirs = np.abs(x - other.x - other.width / 2) / other.width
    return np.asarray(inside_y[:, None] & (inside_x & (theirs < own))[None, :])
