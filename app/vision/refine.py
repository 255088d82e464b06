"""A small network that redraws a silhouette: limbs that the first one lost, edges, neighbours.

It sees the photograph, what the first networks made of it, and where the person's box and the
others' are. It was trained on simulated people before photographs
(``scripts/refinement/train.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.onnx import OnnxNetwork
from app.vision.people import Box
from app.vision.resampling import Window, cut, resize

ROWS, COLUMNS = 192, 128
CHANNELS = 6
PROBABILITY = 3
"""Plane of the input that holds what the first networks saw."""

WEIGHTS_PATH = Path(__file__).parent / "refiner.onnx"

# The window leaves this much room about the box, in shares of its sizes.
_ROOM = 1.1
# People wider than so many times their height are shown smaller rather than squeezed further.
_WIDEST = 1.3


def refiner_window(box: Box) -> Window:
    """Window about a person's box in whole pixels; stretched to 192x128 by little."""
    height = round(_ROOM * max(box.height, box.width / _WIDEST))
    width = round(max(height * COLUMNS / ROWS, _ROOM * box.width))
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    return left, top, max(1, width), max(1, height)


def refiner_input(
    frame: NDArray[np.uint8],
    window: Window,
    box: Box,
    others: Sequence[Box],
    probability: NDArray[np.float32],
) -> NDArray[np.uint8]:
    """What the refiner looks at.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    window : (left, top, width, height)
        Of :func:`refiner_window`.
    box : Box
        The person's, in the frame.
    others : sequence of Box
        Other people's.
    probability : (192, 128) float32 array
        Of the person, 0 to 1, as the first networks see it.

    Returns
    -------
    (6, 192, 128) uint8 array
        Blue, green, red, probability, inside the box, inside others' boxes.
    """
    left, top, width, height = window
    planes: NDArray[np.uint8] = np.zeros((CHANNELS, ROWS, COLUMNS), np.uint8)
    planes[:3] = resize(cut(frame, window), COLUMNS, ROWS).transpose(2, 0, 1)
    planes[PROBABILITY] = np.rint(255 * np.clip(probability, 0, 1))
    across, down = width / COLUMNS, height / ROWS
    for plane, boxes in ((4, [box]), (5, others)):
        for one in boxes:
            x0 = round((one.x + 0.5 - left) / across)
            x1 = round((one.right + 0.5 - left) / across)
            y0 = round((one.y + 0.5 - top) / down)
            y1 = round((one.bottom + 0.5 - top) / down)
            planes[plane, max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)] = 255
    return planes


def moved(probability: NDArray[np.float32], seen: Window, window: Window) -> NDArray[np.float32]:
    """Move what was seen of one window to the refiner's.

    Parameters
    ----------
    probability : (h, w) float32 array
    seen : (left, top, width, height)
        The window of the frame that it covers.
    window : (left, top, width, height)
        Of :func:`refiner_window`.

    Returns
    -------
    (192, 128) float32 array
        0 beyond what was seen.
    """
    across = (window[2] / COLUMNS, probability.shape[1] / seen[2])
    down = (window[3] / ROWS, probability.shape[0] / seen[3])
    # From a pixel of the refiner's window to the same place in what was seen.
    matrix = np.array(
        [
            [across[0] * across[1], 0, (0.5 * across[0] + window[0] - seen[0]) * across[1] - 0.5],
            [0, down[0] * down[1], (0.5 * down[0] + window[1] - seen[1]) * down[1] - 0.5],
        ]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(probability, matrix, (COLUMNS, ROWS), flags=flags))


class Refiner:
    """The network that redraws silhouettes; safe under several threads.

    Parameters
    ----------
    path : Path
        ``refiner.onnx``.

    Raises
    ------
    OnnxError
        If the file cannot be read or is another network.
    """

    def __init__(self, path: Path = WEIGHTS_PATH) -> None:
        self._network = OnnxNetwork(path, (CHANNELS, ROWS, COLUMNS), (1, ROWS, COLUMNS))

    def probability(self, planes: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probability that a pixel shows the person.

        Parameters
        ----------
        planes : (6, 192, 128) uint8 array
            Of :func:`refiner_input`.

        Returns
        -------
        (192, 128) float32 array
            0 to 1.
        """
        probability: NDArray[np.float32] = self._network.run(planes)[0]
        return probability
