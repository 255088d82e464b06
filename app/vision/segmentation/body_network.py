"""The body network: for each pixel of a window, the probability that it shows the central person.

It is the mask output of MediaPipe's pose network.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box
from app.vision.resampling import Window, cut_resized
from app.vision.runtime.tflite import TfliteNetwork

ROWS, COLUMNS = 256, 192
"""Rows and columns of the network's input."""

# Size of the window, as a multiple of the box; chosen on people of even-numbered photographs.
_ROOM = 1.2
# Assumed ratio of height to width of bodies that the frame cuts: the network expects a person at a
# certain place in its window.
_HEIGHT = 2.5
# Boxes this near to the frame's edge are cut by it.
_CUT_PX = 1.0


class BodyNetwork:
    """The network; thread-safe.

    Parameters
    ----------
    path : Path
        ``body_mask.tflite``.
    threads, copies : int
        As in :class:`app.vision.runtime.tflite.TfliteNetwork`.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(self, path: Path, *, threads: int = 1, copies: int = 1) -> None:
        self._network = TfliteNetwork(
            path, (ROWS, COLUMNS, 3), [(ROWS, COLUMNS, 1)], threads=threads, copies=copies
        )

    def probability(self, frame: NDArray[np.uint8], window: Window) -> NDArray[np.float32]:
        """Probability that each pixel of a window shows the person in its middle.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        window : (left, top, width, height)
            Of :func:`body_window`; what lies beyond the frame is black.

        Returns
        -------
        (256, 192) float32 array
            0 to 1.
        """
        picture = cv2.cvtColor(cut_resized(frame, window, COLUMNS, ROWS), cv2.COLOR_BGR2RGB)
        (log_odds,) = self._network.run(picture * np.float32(1 / 255))
        return np.asarray(1 / (1 + np.exp(-np.clip(log_odds[..., 0], -30, 30))))


def body_window(box: Box, frame_rows: int) -> Window:
    """Window about a person's box in whole pixels, three quarters as wide as high.

    Parameters
    ----------
    box : Box
        Tight around the visible person.
    frame_rows : int
        Height of the frame; the window leaves room for what its upper or lower edge cuts off.

    Returns
    -------
    (left, top, width, height)
    """
    above = box.y <= _CUT_PX - 0.5
    below = box.bottom >= frame_rows - 0.5 - _CUT_PX
    hidden = max(0.0, _HEIGHT * box.width - box.height) / max(1, above + below)
    top, bottom = box.y - above * hidden, box.bottom + below * hidden
    height = _ROOM * max(bottom - top, box.width * ROWS / COLUMNS)
    width = height * COLUMNS / ROWS
    left = round(box.x + 0.5 + (box.width - width) / 2)
    first = round(0.5 + (top + bottom - height) / 2)
    return left, first, max(1, round(width)), max(1, round(height))


def resampled(
    probability: NDArray[np.float32], of: Window, window: Window, width: int, height: int
) -> NDArray[np.float32]:
    """Resample the probabilities of one window in another; 0 beyond the first.

    Parameters
    ----------
    probability : (h, w) float32 array
    of, window : (left, top, width, height)
        The window of the probabilities, and the other.
    width, height : int
        Size of the result in pixels.

    Returns
    -------
    (height, width) float32 array
    """
    # From a pixel of the result to the same place in the probabilities.
    across = (window[2] / width, probability.shape[1] / of[2])
    down = (window[3] / height, probability.shape[0] / of[3])
    matrix = np.array(
        [
            [across[0] * across[1], 0, (0.5 * across[0] + window[0] - of[0]) * across[1] - 0.5],
            [0, down[0] * down[1], (0.5 * down[0] + window[1] - of[1]) * down[1] - 0.5],
        ]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(probability, matrix, (width, height), flags=flags))
