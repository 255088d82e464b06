"""Windows and other resolutions of an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

# First column and row, width and height in whole pixels; may reach beyond the image.
Window = tuple[int, int, int, int]

Scalar = TypeVar("Scalar", np.uint8, np.float32)


def cut(image: NDArray[Scalar], window: Window) -> NDArray[Scalar]:
    """Cut a window out of an image; what lies beyond the image is zero.

    Parameters
    ----------
    image : (H, W) or (H, W, C) array
    window : (left, top, width, height)
        Whole pixels.

    Returns
    -------
    (height, width) or (height, width, C) array
        A view where the window lies inside.
    """
    left, top, width, height = window
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


def resize(image: NDArray[Scalar], width: int, height: int) -> NDArray[Scalar]:
    """Resize by averaging areas where the image shrinks, bilinearly where it grows.

    Parameters
    ----------
    image : (H, W) or (H, W, C) array
    width, height : int
        New size in pixels; at least 1.

    Returns
    -------
    (height, width) or (height, width, C) array
    """
    rows, columns = image.shape[:2]
    if (rows, columns) == (height, width):
        return image
    shrinks = width < columns or height < rows
    kind = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return cv2.resize(image, (width, height), interpolation=kind).astype(image.dtype, copy=False)


def planes_of(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Channels of pictures ``(H, W)`` or ``(H, W, C)`` of one size, one below the other.

    Returns
    -------
    (C, H, W) uint8 array
        Of all pictures, in their order.
    """
    channels = sum(1 if picture.ndim == 2 else picture.shape[2] for picture in pictures)
    planes = np.empty((channels, *pictures[0].shape[:2]), np.uint8)
    cv2.mixChannels(pictures, list(planes), np.repeat(np.arange(channels), 2).tolist())
    return planes


def resize_mask(mask: NDArray[np.bool_], width: int, height: int) -> NDArray[np.bool_]:
    """Resize a two-valued mask: a pixel is set where at least half of it is covered."""
    grey: NDArray[np.float32] = mask.astype(np.float32)
    return resize(grey, width, height) >= 0.5
