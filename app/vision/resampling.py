"""Windows and other resolutions of an image."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

# First column and row, width and height in whole pixels; may reach beyond the image.
Window = tuple[int, int, int, int]

Scalar = TypeVar("Scalar", np.uint8, np.float32)

# Windows with more pixels are not cut out before they are resized.
_LARGEST_CUT = 2**22


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


def cut_resized(image: NDArray[Scalar], window: Window, width: int, height: int) -> NDArray[Scalar]:
    """Cut a window out of an image, as :func:`cut`, and resize it to ``width`` and ``height``.

    The window of a person's proportions about a wide, flat box may be many times as large as the
    image. Then only the part inside the image is resized, exact to a pixel of the result, which
    takes no more memory than the image.
    """
    left, top, columns, rows = window
    if columns * rows <= _LARGEST_CUT:
        return resize(cut(image, window), width, height)
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
