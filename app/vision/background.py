"""Silhouettes of people, as the differences from a picture of the empty scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, resize
from app.vision.parameters import DEFAULTS, BackgroundParameters
from app.vision.people import Detection, Silhouette, silhouette_from_mask
from app.vision.silhouettes import fill_small_holes, keep_components, with_truncation


class BackgroundSegmenter:
    """Cuts people out by their difference from the empty scene.

    The difference is kept for further calls with the same frame.

    Parameters
    ----------
    background : (H, W, 3) uint8 array
        BGR picture of the empty scene, taken by the same fixed camera.
    min_person_px : float
        Height of the smallest person wanted, in pixels.
    """

    def __init__(
        self,
        background: NDArray[np.uint8],
        *,
        min_person_px: float = 50,
        parameters: BackgroundParameters = DEFAULTS.background,
    ) -> None:
        self._background = background
        self._min_person_px = min_person_px
        self._parameters = parameters
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
        parameters = self._parameters
        min_height = parameters.min_height_share * self._min_person_px
        rows, columns = frame.shape[:2]
        is_too_thin = rows < min_height or columns < parameters.aspect[0] * min_height
        if is_too_thin and frame.shape == self._background.shape:
            return []
        changed = self._changed(frame)
        # Closing joins the parts of a body, for example if its belt has the pavement's colour.
        reach = max(1, round(self._min_person_px / parameters.height_per_gap))
        kernel: NDArray[np.uint8] = np.ones((2 * reach + 1, 3), np.uint8)
        joined = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
        found = []
        high = np.flatnonzero(stats[1:count, cv2.CC_STAT_HEIGHT] >= min_height) + 1
        for label, (left, top, width, height, _) in zip(high, stats[high].tolist(), strict=True):
            part = np.s_[top : top + height, left : left + width]
            own = changed[part] & (labels[part] == label)
            score = _likeness(width / height, float(own.mean()), parameters)
            if score > 0:
                found.append(Detection(Box(left - 0.5, top - 0.5, width, height), score))
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
        min_part, max_hole = self._parameters.min_part, self._parameters.max_hole
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
            mask = fill_small_holes(keep_components(mask, min_part), max_hole)
            found.append(silhouette_from_mask(mask, left=left, top=top, segmenter="background"))
        return with_truncation(found, boxes, frame.shape)

    def _changed(self, frame: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Pixels ``(H, W)`` that differ from the scene."""
        compared = self._compared
        if compared is None or compared[0] is not frame:
            changed = foreground(frame, self._background, self._parameters)
            compared = self._compared = frame, changed
        return compared[1]


def foreground(
    frame: NDArray[np.uint8],
    background: NDArray[np.uint8],
    parameters: BackgroundParameters = DEFAULTS.background,
) -> NDArray[np.bool_]:
    """Pixels that differ from the background by more than exposure, noise and shadow explain.

    Exposure is a gain and an offset for each channel, fitted to the pixels that agree; the noise is
    estimated from what remains. A shadow dims all channels alike and evenly.

    Parameters
    ----------
    frame, background : (H, W, 3) uint8 array
        BGR.

    Returns
    -------
    (H, W) bool array

    Raises
    ------
    ValueError
        If the shapes of frame and background differ.
    """
    if frame.shape != background.shape:
        raise ValueError(f"expected a background of shape {frame.shape}, got {background.shape}")
    height, width = frame.shape[:2]
    if height * width > parameters.max_px:
        factor = math.sqrt(parameters.max_px / (height * width))
        size = max(1, int(factor * width)), max(1, int(factor * height))
        reduced = foreground(resize(frame, *size), resize(background, *size), parameters)
        return cv2.resize(
            reduced.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
        ).view(np.bool_)
    now, scene = (
        cv2.GaussianBlur(image, (0, 0), parameters.blur_px).astype(np.float32)
        for image in (frame, background)
    )
    expected = _with_exposure_of(now, scene, parameters)
    distance, difference = _distances(now, expected, parameters)
    distance[_shadow(now, expected, parameters)] = 0
    grown = _hysteresis(
        distance > parameters.possible_distance, distance > parameters.certain_distance
    )
    opened = cv2.morphologyEx(grown.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return _without_halo(closed > 0, difference, parameters.min_cover)


def _with_exposure_of(
    now: NDArray[np.float32], scene: NDArray[np.float32], parameters: BackgroundParameters
) -> NDArray[np.float32]:
    """The scene ``(H, W, 3)``, adapted in place to the exposure of this frame."""
    for channel in range(3):
        x, y = scene[::4, ::4, channel].ravel(), now[::4, ::4, channel].ravel()
        gain, offset = _fit_exposure(x, y, parameters)
        scene[..., channel] = gain * scene[..., channel] + offset
    return np.clip(scene, 1, 255, out=scene)


def _fit_exposure(
    x: NDArray[np.float32], y: NDArray[np.float32], parameters: BackgroundParameters
) -> tuple[float, float]:
    """Gain and offset from samples ``(N,)`` of the scene to those of the frame."""
    low, high = parameters.exposure_range
    usable = (x > low) & (x < high) & (y > low) & (y < high)
    if np.count_nonzero(usable) < parameters.min_exposure_samples:
        return 1.0, 0.0
    x, y = x[usable], y[usable]
    gain, offset = float(np.median(y / x)), 0.0
    # People are outliers: the fit is repeated on the samples that agree with it.
    for _ in range(parameters.exposure_rounds):
        error = np.abs(y - gain * x - offset)
        limit = parameters.exposure_outlier * float(np.median(error))
        agree = error <= max(parameters.min_exposure_error, limit)
        centre_x, centre_y = float(x[agree].mean()), float(y[agree].mean())
        spread = float(((x[agree] - centre_x) ** 2).sum())
        if spread < 1:
            break
        gain = float(((x[agree] - centre_x) * (y[agree] - centre_y)).sum()) / spread
        offset = centre_y - gain * centre_x
    return gain, offset


def _distances(
    now: NDArray[np.float32], expected: NDArray[np.float32], parameters: BackgroundParameters
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distances ``(H, W)`` in standard deviations of the noise, and the largest difference."""
    squares = np.zeros(now.shape[:2], np.float32)
    difference = np.zeros(now.shape[:2], np.float32)
    # Working channel by channel takes a third of the memory.
    for channel in range(3):
        residual = np.abs(now[..., channel] - expected[..., channel])
        # A normal distribution's standard deviation is 1.4826 times its median deviation.
        noise = max(1.4826 * float(np.median(residual[::2, ::2])), parameters.min_noise)
        contrast = cv2.morphologyEx(
            expected[..., channel], cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)
        )
        squares += residual**2 / (noise**2 + (parameters.contrast_noise * contrast) ** 2)
        np.maximum(difference, residual, out=difference)
    return np.sqrt(squares / 3), difference


def _shadow(
    now: NDArray[np.float32], expected: NDArray[np.float32], parameters: BackgroundParameters
) -> NDArray[np.bool_]:
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
    darkest, brightest = parameters.shadow_light
    return np.asarray(
        (light > darkest)
        & (light < brightest)
        & (tint < parameters.max_shadow_tint)
        & (unevenness < parameters.max_shadow_unevenness)
    )


def _hysteresis(possible: NDArray[np.bool_], certain: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The connected parts of ``possible`` that include a pixel of ``certain``."""
    count, labels = cv2.connectedComponents(possible.astype(np.uint8))
    chosen = np.bincount(labels[certain & possible], minlength=count) > 0
    chosen[0] = False
    return np.asarray(chosen[labels])


def _without_halo(
    mask: NDArray[np.bool_], difference: NDArray[np.float32], min_cover: float
) -> NDArray[np.bool_]:
    """Drop border pixels of which a person covers less than half, since lenses blur edges.

    Such pixels differ from the background less than half as much as pixels further inside.
    """
    kernel: NDArray[np.uint8] = np.ones((5, 5), np.uint8)
    inside = cv2.erode(mask.astype(np.uint8), kernel, borderValue=1) > 0
    strongest = cv2.dilate(np.where(mask, difference, 0).astype(np.float32), kernel)
    return np.asarray(inside | (mask & (difference > min_cover * strongest)))


def _likeness(aspect: float, fill: float, parameters: BackgroundParameters) -> float:
    """How much a region's proportions and solidity resemble an upright body."""
    if not parameters.aspect[0] <= aspect <= parameters.aspect[-1] or fill < parameters.fill[0]:
        return 0.0
    upright = float(np.interp(aspect, parameters.aspect, parameters.aspect_score))
    solid = float(np.interp(fill, parameters.fill, parameters.fill_score))
    return parameters.max_score * upright * solid


def _nearer_to_other(box: Box, other: Box, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels of ``box``, of this shape, that also lie in ``other`` and are nearer its middle."""
    left, top, _, _ = box.pixels()
    x, y = left + np.arange(shape[1]), top + np.arange(shape[0])
    inside_x = (x >= other.x) & (x <= other.right)
    inside_y = (y >= other.y) & (y <= other.bottom)
    own = np.abs(x - box.x - box.width / 2) / box.width
    theirs = np.abs(x - other.x - other.width / 2) / other.width
    return np.asarray(inside_y[:, None] & (inside_x & (theirs < own))[None, :])
