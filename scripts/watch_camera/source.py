"""The newest frame of a file, a device or a stream."""

import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from app.video.frames import UnreadableError, Video
from scripts.watch_camera.common import Trouble, say

STREAM_TIMEOUT_S = 10.0
_POLL_S = 0.2


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
        self._trouble = Trouble("the source gives frames")
        # Unix time that never goes back, whatever happens to the clock meanwhile.
        self._clock_ahead_s = time.time() - time.monotonic()
        threading.Thread(target=self._read, daemon=True).start()

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Yield the newest frame whenever there is one, until a file ends or this is stopped."""
        while not stopping.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._ended, _POLL_S)
                frame, self._newest = self._newest, None
                if frame is None and self._ended:
                    return
            if frame is not None:
                yield frame

    def _read(self) -> None:
        while True:
            try:
                self._read_once()
            except UnreadableError as error:
                if self.is_file:
                    say(f"expected a whole video, got {error}")
            if self.is_file:
                break
            # Its address may hold a password, anywhere.
            time.sleep(self._trouble.report("the source gives no frame; trying again"))
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _read_once(self) -> None:
        began = time.monotonic()
        for elapsed_s, pixels in self._pictures():
            moment = time.monotonic()
            if self.is_file:
                # Play it as fast as it was filmed.
                moment = began + elapsed_s
                time.sleep(max(0.0, moment - time.monotonic()))
            with self._changed:
                self._newest = Frame(self._number, self._clock_ahead_s + moment, pixels)
                self._changed.notify()
            self._trouble.end()
            self._number += 1

    def _pictures(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Yield seconds since the first frame, 0 for a device, and pixels."""
        if self._source.isdecimal():
            device = cv2.VideoCapture(int(self._source))
            while (read := device.read())[0]:
                yield 0.0, np.asarray(read[1], np.uint8)
            device.release()
            return
        # A file's name may look like an address. Streams over UDP lose parts of frames.
        address = f"file:{self._source}" if self.is_file else self._source
        options = {} if self.is_file else {"rtsp_transport": "tcp"}
        with closing(Video(address, options, STREAM_TIMEOUT_S)) as video:
            for frame in video.frames():
                yield frame.timestamp, frame.pixels
