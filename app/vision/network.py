"""The segmentation network, run by OpenCV: windows of a frame to person probabilities."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from app.vision.resampling import Window, cut, resize

SIZE = 256
# Bounds the memory of a pass; a larger batch is no faster.
BATCH = 8
# A layer half-way, 16x16 pixels of 32 channels.
INNER_LAYER = "add_2__xeno_compat__1"


class NetworkError(RuntimeError):
    """The model file is missing or is not the expected network."""


class PersonNetwork:
    """MediaPipe's selfie segmentation: 256x256 RGB in, probability of a person out.

    Safe under several threads: an OpenCV network keeps its input and its layers' outputs
    inside, so each thread reads its own copies of the 249 KB file, one for each layer asked
    for (OpenCV sets a network up anew when that changes); a lock would make the request threads
    wait for one another.

    Parameters
    ----------
    model_path : Path
        ``selfie_segmentation.tflite``.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(self, model_path: Path) -> None:
        try:
            self._model = np.frombuffer(model_path.read_bytes(), np.uint8)
        except OSError as error:
            raise NetworkError(f"cannot read the segmentation model: {error}") from error
        self._local = threading.local()
        try:
            shape = self._forward(np.zeros((1, 3, SIZE, SIZE), np.float32), "").shape
        except cv2.error as error:
            raise NetworkError(f"{model_path} is not a network OpenCV can run") from error
        if shape != (1, 1, SIZE, SIZE):
            raise NetworkError(f"expected a network with output (1, 1, 256, 256), got {shape}")

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
        result = np.empty((len(images), SIZE, SIZE), np.float32)
        for start in range(0, len(images), BATCH):
            inputs = [resize(image, SIZE, SIZE) for image in images[start : start + BATCH]]
            blob = cv2.dnn.blobFromImages(inputs, 1 / 255, swapRB=True)
            result[start : start + BATCH] = self._forward(blob, "")[:, 0]
        return result

    def features(self, frame: NDArray[np.uint8], window: Window) -> NDArray[np.float32]:
        """What the network knows half-way of a window of a frame, ``(32, 16, 16)``."""
        pixels = resize(cut(frame, window), SIZE, SIZE)
        blob = cv2.dnn.blobFromImages([pixels], 1 / 255, swapRB=True)
        return np.asarray(self._forward(blob, INNER_LAYER)[0], np.float32)

    def _forward(self, blob: MatLike, layer: str) -> NDArray[np.float32]:
        """Output of a layer; of the last one for an empty name."""
        nets: dict[str, cv2.dnn.Net] = self._local.__dict__
        net = nets.get(layer)
        if net is None:
            net = nets[layer] = cv2.dnn.readNetFromTFLite(self._model)
        net.setInput(blob)
        # The output lies in the network's memory, which the next pass overwrites.
        return np.array(net.forward(layer) if layer else net.forward(), np.float32)


def load_network(model_path: Path | None) -> PersonNetwork | None:
    """Load the network if its file is there and sound; the service runs without it, less well."""
    if model_path is None:
        return None
    try:
        return PersonNetwork(model_path)
    except NetworkError:
        return None
