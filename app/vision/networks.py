"""The segmentation networks: windows of a frame to probabilities that a pixel shows a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box
from app.vision.resampling import Window, cut, resize
from app.vision.tflite import TfliteError, TfliteNetwork
from app.vision.workers import Workers

SIZE = 256
"""Rows and columns that :class:`PersonNetwork` sees."""

ROWS, COLUMNS = 256, 192
"""Rows and columns that :class:`BodyNetwork` sees."""

PERSON_FILE, BODY_FILE = "selfie_segmentation.tflite", "body_mask.tflite"

# The body's window leaves this much room about the box, in shares of its sizes; chosen on street
# people of even-numbered photographs.
_ROOM = 1.2
# Bodies that the frame cuts go on beyond it until they are so many times as high as wide: the
# network knows people by where they are in its window.
_HEIGHT = 2.5
# So near to the frame's edge, in pixels, a box is cut by it.
_CUT_PX = 1.0


class PersonNetwork:
    """MediaPipe's selfie segmentation: whether anybody is there, wherever in a window.

    Safe under several threads.

    Parameters
    ----------
    model_path : Path
        ``selfie_segmentation.tflite``.
    workers : Workers, optional
        Who looks at several windows; by default the caller's thread, at one after the other.

    Raises
    ------
    TfliteError
        If the file cannot be read or is another network.
    """

    def __init__(self, model_path: Path, workers: Workers | None = None) -> None:
        self._workers = workers or Workers()
        self._network = TfliteNetwork(model_path, (SIZE, SIZE, 3), (SIZE, SIZE, 1))

    def probabilities(
        self, frame: NDArray[np.uint8], windows: Sequence[Window]
    ) -> NDArray[np.float32]:
        """Person probability in windows of a frame.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        windows : sequence of (left, top, width, height)
            Whole pixels. What lies beyond the frame is black. Each is stretched to 256x256.

        Returns
        -------
        (N, 256, 256) float32 array
            0 to 1.
        """
        return self.of_images([cut(frame, window) for window in windows])

    def of_images(self, images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float32]:
        """Person probability in images, each stretched to 256x256.

        Parameters
        ----------
        images : sequence of (h, w, 3) uint8 arrays
            BGR, of any sizes.

        Returns
        -------
        (N, 256, 256) float32 array
            0 to 1.
        """
        answers = self._workers.map(self.of_image, images)
        return np.array(answers, np.float32).reshape(len(images), SIZE, SIZE)

    def of_image(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """As :meth:`of_images`, of one, by the caller's thread: ``(256, 256)``."""
        return self._network.run(_rgb(resize(image, SIZE, SIZE)))[..., 0]


class BodyNetwork:
    """The mask of MediaPipe's pose network: the body of the one person in the middle of a window.

    Safe under several threads.

    Parameters
    ----------
    model_path : Path
        ``body_mask.tflite``, as ``scripts/fetch_models.py`` leaves it.

    Raises
    ------
    TfliteError
        If the file cannot be read or is another network.
    """

    def __init__(self, model_path: Path) -> None:
        # A second copy takes 27 MB, and saves a twentieth of a frame of several people at most.
        self._network = TfliteNetwork(model_path, (ROWS, COLUMNS, 3), (ROWS, COLUMNS, 1), copies=1)

    def probability(self, frame: NDArray[np.uint8], window: Window) -> NDArray[np.float32]:
        """Probability that a pixel of a window shows the person in its middle.

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
        odds = self._network.run(_rgb(resize(cut(frame, window), COLUMNS, ROWS)))[..., 0]
        # Odds are clipped where single precision knows no more than 0 and 1.
        return np.asarray(1 / (1 + np.exp(-np.clip(odds, -30, 30))))


def body_window(box: Box, frame_rows: int) -> Window:
    """Window about a person's box in whole pixels, three quarters as wide as high.

    Parameters
    ----------
    box : Box
        Tight around the visible person.
    frame_rows : int
        Height of the frame: what its upper or lower edge cuts off has room in the window.

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


def _rgb(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) * np.float32(1 / 255)


@dataclass(frozen=True)
class Networks:
    """Where people are, and the body of each."""

    person: PersonNetwork
    body: BodyNetwork

    @classmethod
    def load(cls, folder: Path, workers: Workers | None = None) -> Networks:
        """Load both from a folder; raises :class:`app.vision.tflite.TfliteError`."""
        return cls(PersonNetwork(folder / PERSON_FILE, workers), BodyNetwork(folder / BODY_FILE))


def load_networks(folder: Path | None, workers: Workers | None = None) -> Networks | None:
    """Load the networks if both files are there and sound; the service runs without, less well."""
    if folder is None:
        return None
    try:
        return Networks.load(folder, workers)
    except TfliteError:
        return None
