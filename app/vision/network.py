"""The segmentation network: windows of a frame to person probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.resampling import Window, cut, resize
from app.vision.tflite import TfliteError, TfliteNetwork
from app.vision.workers import Workers

SIZE = 256


class PersonNetwork:
    """MediaPipe's selfie segmentation: 256x256 RGB in, probability of a person out.

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
        answers = self._workers.map(self._of_image, images)
        return np.array(answers, np.float32).reshape(len(images), SIZE, SIZE)

    def _of_image(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        pixels = cv2.cvtColor(resize(image, SIZE, SIZE), cv2.COLOR_BGR2RGB)
        return self._network.run(pixels * np.float32(1 / 255))[..., 0]


def load_network(model_path: Path | None, workers: Workers | None = None) -> PersonNetwork | None:
    """Load the network if its file is there and sound; the service runs without it, less well."""
    if model_path is None:
        return None
    try:
        return PersonNetwork(model_path, workers)
    except TfliteError:
        return None
