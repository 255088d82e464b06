"""Copies of one network, so that several threads may run it at once."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.copies import Copies


class NetworkPool:
    """A network of OpenCV; safe under several threads.

    OpenCV's networks keep their layers' outputs inside, so each serves one call at a time.

    Parameters
    ----------
    read : callable
        Reads a copy.
    """

    def __init__(self, read: Callable[[], cv2.dnn.Net]) -> None:
        self._copies = Copies(read)

    def run(self, blob: NDArray[np.float32]) -> NDArray[np.float32]:
        """Show it one input ``(1, C, H, W)`` and return the answer to it, without the batch axis.

        Raises
        ------
        cv2.error
            If the network cannot be read or run.
        """
        with self._copies.one() as net:
            net.setInput(blob)
            # The output lies in the network's memory, which the next pass overwrites.
            return np.array(net.forward()[0], np.float32)
