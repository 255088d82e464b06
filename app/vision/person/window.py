"""Windows about people: how they are placed, and how a frame is sampled in them."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box, PersonWindow
from app.vision.resampling import resize

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
