"""A network of our own, stored as ONNX beside the code and run by OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.copies import Copies


class OnnxError(RuntimeError):
    """A network's file is missing or is not the expected network."""


class OnnxNetwork:
    """Planes of bytes in, planes of numbers out.

    Safe under several threads.

    Parameters
    ----------
    path : Path
    entering, leaving : tuple of int
        Shapes of input, which is planes, rows and columns, and output.
    winograd : bool
        Whether convolutions take a third less time, and their weights five times the memory.

    Raises
    ------
    OnnxError
        If the file cannot be read or is another network.
    """

    def __init__(
        self,
        path: Path,
        entering: tuple[int, int, int],
        leaving: tuple[int, ...],
        *,
        winograd: bool = True,
    ) -> None:

        def read() -> cv2.dnn.Net:
            # Anew for each copy: kept, the files of all networks would take 11 MB.
            net = cv2.dnn.readNetFromONNX(np.frombuffer(path.read_bytes(), np.uint8))
            net.enableWinograd(winograd)
            return net

        # OpenCV's networks keep their layers' outputs inside: each serves one call at a time.
        self._copies = Copies(read)
        try:
            shape = self.run(np.zeros(entering, np.uint8)).shape
        except OSError as error:
            raise OnnxError(f"cannot read a network: {error}") from error
        except cv2.error as error:
            raise OnnxError(f"{path} is not a network OpenCV can run") from error
        if shape != leaving:
            raise OnnxError(f"expected {path} to answer with shape {leaving}, got {shape}")

    def run(self, planes: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Show it planes ``(C, H, W)``, of which 255 is 1."""
        with self._copies.one() as net:
            net.setInput(planes[None], "", 1 / 255)
            # The output lies in the network's memory, which the next pass overwrites.
            return np.array(net.forward()[0], np.float32)
