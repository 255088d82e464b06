"""Windows about people, as networks are shown them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box, Silhouette
from app.vision.resampling import Window, cut, resize

# The network sees a window of the box's height and 0.8 times as wide, stretched to its
# square: of the windows tried, the one with the best overlap.
_WINDOW_ASPECT = 0.8
# Beyond the box by this share of its height the window is greyed: the network likes to join
# people, and what it does not see it does not join.
_SURROUNDINGS = 0.1
_GREY = 127
# Windows are shown at no more than this height: finer than the network's own 256 rows.
_ROWS = 320


@dataclass(frozen=True)
class View:
    """The window around one person.

    ``image`` is (h, w, 3) uint8; ``box`` is in its pixels, ``window`` in the frame's.
    """

    image: NDArray[np.uint8]
    box: Box
    window: Window


def silhouette_in(
    window: Window, silhouette: Silhouette, width: int, height: int
) -> NDArray[np.uint8]:
    """What a window of the frame holds of a silhouette in it, resized: 255 on the person.

    Returns
    -------
    (height, width) uint8 array
    """
    left, top, columns, rows = window
    within = (left - silhouette.left, top - silhouette.top, columns, rows)
    return resize(cut(silhouette.crop.view(np.uint8), within) * np.uint8(255), width, height)


def view_of(frame: NDArray[np.uint8], box: Box) -> View:
    """Cut the window around a person's box out of a frame."""
    left, top, right, bottom = box.pixels()
    height = max(bottom - top, round((right - left) / 1.6))
    width = max(round(_WINDOW_ASPECT * height), right - left)
    window = ((left + right - width) // 2, (top + bottom - height) // 2, width, height)
    scale = min(1.0, _ROWS / height)
    image = resize(cut(frame, window), max(1, round(width * scale)), max(1, round(height * scale)))
    local = Box(box.x - window[0], box.y - window[1], box.width, box.height).scaled(scale)
    return View(image, local, window)


def with_grey_surroundings(view: View) -> NDArray[np.uint8]:
    """View with everything but the box hidden, softly: a new edge must not look like a body's."""
    reach = _SURROUNDINGS * view.box.height
    left, top = view.box.x - reach, view.box.y - reach
    near = Box(left, top, view.box.width + 2 * reach, view.box.height + 2 * reach)
    x0, y0, x1, y1 = near.pixels()
    rows, columns = view.image.shape[:2]
    shown: NDArray[np.float32] = np.zeros((rows, columns, 1), np.float32)
    shown[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)] = 1
    blur = 2 * max(1, round(0.05 * rows)) + 1
    shown = cv2.blur(shown, (blur, blur)).astype(np.float32)[..., None]
    return (view.image * shown + _GREY * (1 - shown)).astype(np.uint8)
