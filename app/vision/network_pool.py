"""Copies of one network, so that several threads may run it at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray


class NetworkPool:
    """As many copies of a network as were ever run at once; safe under several threads.

    OpenCV's networks keep their layers' outputs inside, so each serves one call at a time. Another
    is read only where a call comes while all are busy.

    Parameters
    ----------
    read : callable
        Reads a copy.
    """

    def __init__(self, read: Callable[[], cv2.dnn.Net]) -> None:
        self._read = read
        self._idle: deque[cv2.dnn.Net] = deque()

    def run(self, blob: NDArray[np.float32]) -> NDArray[np.float32]:
        """Show it one input ``(1, C, H, W)`` and return the answer to it, without the batch axis.

        Raises
        ------
        cv2.error
            If the network cannot be read or run.
        """
        try:
            net = self._idle.pop()
        except IndexError:
            net = self._read()
        net.setInput(blob)
        # The output lies in the network's memory, which the next pass overwrites.
        answer = np.array(net.forward()[0], np.float32)
        self._idle.append(net)
        return answer
