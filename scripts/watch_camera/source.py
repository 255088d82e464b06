"""The newest frame of a file, a device or a stream."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from scripts.watch_camera.common import say

RECONNECT_AFTER_S = (1.0, 2.0, 5.0, 10.0)


class Frame(NamedTuple):
    """A frame: the number of frames before it, Unix seconds and BGR pixels."""

    number: int
    timestamp: float
    pixels: NDArray[np.uint8]


class Source:
    """Reads frames in a thread of its own and keeps only the newest."""

    def __init__(self, source: str) -> None:
        self._source = source
        self.is_file = Path(source).is_file()
        self._newest: Frame | None = None
        self._number = 0
        self._ended = False
        self._changed = threading.Condition()
        # Unix time that never goes back, whatever happens to the clock meanwhile.
        self._clock_ahead_s = time.time() - time.monotonic()
        threading.Thread(target=self._read, daemon=True).start()

    def frames(self) -> Iterator[Frame]:
        """Yield the newest frame whenever there is one; ends with a file, never with a stream."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._ended)
                frame, self._newest = self._newest, None
            if frame is None:
                return
            yield frame

    def _read(self) -> None:
        attempt = 0
        while True:
            capture = self._open()
            before = self._number
            self._read_from(capture)
            capture.release()
            if self.is_file:
                break
            attempt = 0 if self._number > before else attempt + 1
            wait_s = RECONNECT_AFTER_S[min(attempt, len(RECONNECT_AFTER_S) - 1)]
            say(f"{self._source} gives no frame; trying again in {wait_s:g} s")
            time.sleep(wait_s)
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _open(self) -> cv2.VideoCapture:
        if self._source.isdecimal():
            return cv2.VideoCapture(int(self._source))
        timeouts = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 10_000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 10_000)
        return cv2.VideoCapture(self._source, cv2.CAP_FFMPEG, timeouts)

    def _read_from(self, capture: cv2.VideoCapture) -> None:
        interval_s = 1 / (capture.get(cv2.CAP_PROP_FPS) or 25.0)
        began = time.monotonic()
        while True:
            read, pixels = capture.read()
            if not read:
                return
            moment = time.monotonic()
            if self.is_file:
                # Play it as fast as it was filmed.
                moment = began + self._number * interval_s
                time.sleep(max(0.0, moment - time.monotonic()))
            with self._changed:
                timestamp = self._clock_ahead_s + moment
                self._newest = Frame(self._number, timestamp, np.asarray(pixels, np.uint8))
                self._changed.notify()
            self._number += 1
