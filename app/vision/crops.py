"""Pixels of a part of an image: upright rectangles, and windows rotated with a person."""

from __future__ import annotations

import math
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import PersonWindow

PixelRect = tuple[int, int, int, int]
"""First column and row, width and height in whole pixels; may reach beyond the image."""

Scalar = TypeVar("Scalar", np.uint8, np.float32)


def crop(image: NDArray[Scalar], rect: PixelRect) -> NDArray[Scalar]:
    """Crop an image ``(H, W)`` or ``(H, W, C)``; pixels beyond it are zero.

    Returns
    -------
    (height, width) or (height, width, C) array
        A view where the rectangle lies inside the image.
    """
    left, top, width, height = rect
    rows, columns = image.shape[:2]
    inside = image[
        min(max(top, 0), rows) : max(0, min(top + height, rows)),
        min(max(left, 0), columns) : max(0, min(left + width, columns)),
    ]
    if inside.shape[:2] == (height, width):
        return inside
    result = np.zeros((height, width, *image.shape[2:]), image.dtype)
    y, x = max(-top, 0), max(-left, 0)
    result[y : y + inside.shape[0], x : x + inside.shape[1]] = inside
    return result


def crop_and_resize(
    image: NDArray[Scalar], rect: PixelRect, width: int, height: int, max_crop_px: int = 2**22
) -> NDArray[Scalar]:
    """Crop an image as :func:`crop` does and resize the crop to ``width`` x ``height``.

    A rectangle with a person's proportions about a wide, flat box may be many times as large as the
    image. If it has more than ``max_crop_px`` pixels, only the part inside the image is resized.
    The result is then accurate to a pixel, and needs no more memory than the image.
    """
    left, top, columns, rows = rect
    if columns * rows <= max_crop_px:
        return resize(crop(image, rect), width, height)
    result = np.zeros((height, width, *image.shape[2:]), image.dtype)
    x0, x1 = (min(max(x, 0), image.shape[1]) for x in (left, left + columns))
    y0, y1 = (min(max(y, 0), image.shape[0]) for y in (top, top + rows))
    first, last = (round((x - left) * width / columns) for x in (x0, x1))
    upper, lower = (round((y - top) * height / rows) for y in (y0, y1))
    if last > first and lower > upper:
        inside = image[y0:y1, x0:x1]
        result[upper:lower, first:last] = resize(inside, last - first, lower - upper)
    return result


def resize(image: NDArray[Scalar], width: int, height: int) -> NDArray[Scalar]:
    """Resize an image, by averaging areas where it shrinks and bilinearly where it grows."""
    rows, columns = image.shape[:2]
    if (rows, columns) == (height, width):
        return image
    shrinks = width < columns or height < rows
    kind = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return cv2.resize(image, (width, height), interpolation=kind).astype(image.dtype, copy=False)


def sample_window(
    frame: NDArray[np.uint8], window: PersonWindow, pixels: int, max_step: float = 1.5
) -> NDArray[np.uint8]:
    """Sample a window of a frame; what lies beyond the frame is black.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
    window : PersonWindow
    pixels : int
        Side of the result.
    max_step : float
        The frame is averaged first until a pixel of the result covers about this many pixels.

    Returns
    -------
    (pixels, pixels, 3) uint8 array
    """
    size = np.array([frame.shape[1], frame.shape[0]])
    centre = np.array([window.x, window.y])
    # Only the part about the window is averaged.
    reach = window.side * math.sqrt(0.5) + 1
    low = np.clip(centre - reach, 0, size).astype(int)
    high = np.clip(centre + reach + 2, 0, size).astype(int)
    if (high <= low).any():
        return np.zeros((pixels, pixels, 3), np.uint8)
    part = frame[low[1] : high[1], low[0] : high[0]]
    matrix = window.to_frame(pixels)
    matrix[:, 2] -= low
    # Averaging over whole numbers of pixels is ten times as fast.
    factor = round(window.side / (max_step * pixels))
    if factor > 1:
        factors = np.minimum(factor, high - low)
        reduced = (high - low) // factors
        width, height = (factors * reduced).tolist()
        part = resize(part[:height, :width], *reduced.tolist())
        # The matrix now leads to pixels of the averaged part, with the origin at the centre of the
        # first one.
        matrix /= factors[:, None]
        matrix[:, 2] += 0.5 / factors - 0.5
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(part, matrix, (pixels, pixels), flags=flags), np.uint8)
