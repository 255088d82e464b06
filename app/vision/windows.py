"""Windows of an image: axis-aligned crops, and squares turned with a person's trunk."""

from __future__ import annotations

import math
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, PersonWindow

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


ROOM = 1.25
"""Side of a window, as a multiple of the circle about the body or of the longer side of its box."""

# A frame is averaged before it is sampled, until a pixel of the window covers about this many.
_SAMPLED_PIXELS = 1.5


def window_about(box: Box, roll_deg: float = 0.0) -> PersonWindow:
    """Window about a person's box."""
    side = ROOM * max(box.width, box.height)
    return PersonWindow(box.x + box.width / 2, box.y + box.height / 2, side, roll_deg)


def window_of_circle(centre: NDArray[np.floating], on_circle: NDArray[np.floating]) -> PersonWindow:
    """Window about the circle around a body.

    Parameters
    ----------
    centre : (2,) array
        Middle of the hips.
    on_circle : (2,) array
        The point of the circle towards the head.
    """
    right, down = (np.asarray(on_circle, np.float64) - centre).tolist()
    radius = max(math.hypot(right, down), 1e-3)
    roll_deg = math.degrees(math.atan2(right, -down))
    return PersonWindow(float(centre[0]), float(centre[1]), 2 * ROOM * radius, roll_deg)


def window_to_frame(window: PersonWindow, pixels: int) -> NDArray[np.float64]:
    """Affine transform ``(2, 3)`` from a window at ``pixels`` a side to the frame."""
    angle = math.radians(window.roll_deg)
    scale = window.side / pixels
    cosine, sine = scale * math.cos(angle), scale * math.sin(angle)
    linear = np.array([[cosine, -sine], [sine, cosine]])
    middle = (pixels - 1) / 2
    offset = np.array([window.x, window.y]) - linear @ np.array([middle, middle])
    return np.column_stack([linear, offset])


def window_corners(window: PersonWindow) -> NDArray[np.float64]:
    """Corners ``(4, 2)`` in the frame, clockwise from the one above the head on the left."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * 2 - 0.5
    matrix = window_to_frame(window, 2)
    return np.asarray(corners @ matrix[:, :2].T + matrix[:, 2])


def window_drift(window: PersonWindow, other: PersonWindow) -> float:
    """Mean distance between the corners of two windows, as a share of the first one's side."""
    apart = window_corners(window) - window_corners(other)
    return float(np.linalg.norm(apart, axis=1).mean() / window.side)


def cut_window(frame: NDArray[np.uint8], window: PersonWindow, pixels: int) -> NDArray[np.uint8]:
    """Sample a window of a frame; what lies beyond the frame is black.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
    window : PersonWindow
    pixels : int

    Returns
    -------
    (pixels, pixels, 3) uint8 array
    """
    rows, columns = frame.shape[:2]
    # Only the part about the window is averaged.
    reach = window.side * math.sqrt(0.5) + 1
    left, top = (int(np.clip(at - reach, 0, end)) for at, end in _ends(window, columns, rows))
    right, bottom = (
        int(np.clip(at + reach + 2, 0, end)) for at, end in _ends(window, columns, rows)
    )
    if right <= left or bottom <= top:
        return np.zeros((pixels, pixels, 3), np.uint8)
    part = frame[top:bottom, left:right]
    matrix = window_to_frame(window, pixels)
    matrix[:, 2] -= [left, top]
    # Whole numbers of pixels are averaged ten times as fast.
    most = round(window.side / (_SAMPLED_PIXELS * pixels))
    if most > 1:
        averaged = np.minimum(most, [right - left, bottom - top])
        size = [right - left, bottom - top] // averaged
        across, down = (averaged * size).tolist()
        part = resize(part[:down, :across], *size.tolist())
        # To pixels of the averaged part, whose origin is the centre of its first pixel.
        matrix /= averaged[:, None]
        matrix[:, 2] += 0.5 / averaged - 0.5
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(part, matrix, (pixels, pixels), flags=flags), np.uint8)


def _ends(window: PersonWindow, columns: int, rows: int) -> tuple[tuple[float, int], ...]:
    return (window.x, columns), (window.y, rows)
