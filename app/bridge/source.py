"""The newest frame of a file, a device or a stream."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.bridge import Trouble, say
from app.decoding import Frame
from app.decoding.videos import Decoder, VideoError

_POLL_S = 0.2


class Source:
    """Reads up to ``fps`` frames a second in a thread of its own and keeps only the newest.

    Their timestamps are Unix seconds, their numbers those of frames before them.
    """

    def __init__(self, source: str, fps: float = math.inf) -> None:
        self._source, self._interval_s = source, 1 / fps
        self.is_file = Path(source).is_file()
        self._newest: Frame | None = None
        self._number = 0
        self._ended = False
        self._changed = threading.Condition()
        self._trouble = Trouble("the source gives frames")
        # Unix time at the zero of the monotonic clock, which no correction of seconds moves.
        self._clock_s = time.time() - time.monotonic()
        self._closed = threading.Event()
        self._decoder: Decoder | None = None
        name = threading.current_thread().name
        threading.Thread(target=self._read, name=name, daemon=True).start()

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

    def close(self) -> None:
        """Read no more."""
        self._closed.set()
        if self._decoder is not None:
            self._decoder.kill()

    def _read(self) -> None:
        while not self._closed.is_set():
            try:
                self._read_once()
            except (VideoError, OSError) as error:
                if self.is_file and not self._closed.is_set():
                    say(str(error))
            if self.is_file or self._closed.is_set():
                break
            # Its address may hold a password, anywhere.
            self._closed.wait(self._trouble.report("the source gives no frame; trying again"))
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _read_once(self) -> None:
        began, last_s = math.inf, 0.0
        for elapsed_s, pixels in self._pictures():
            moment = time.monotonic()
            began = min(began, moment)  # With the first frame.
            if self.is_file:
                # Play it as fast as it was filmed.
                if elapsed_s - last_s > 10.0:  # A recording plays on at once.
                    began -= elapsed_s - last_s
                moment, last_s = began + elapsed_s, elapsed_s
                self._closed.wait(max(0.0, moment - time.monotonic()))
            with self._changed:
                self._newest = Frame(self._number, self._time_of_day(moment), pixels)
                self._changed.notify()
            self._trouble.end()
            self._number += 1

    def _time_of_day(self, moment: float) -> float:
        """Unix seconds of the monotonic clock; a machine may get the time late, or be suspended."""
        clock_s = time.time() - time.monotonic()
        # Longer than the 5 s after which the service takes an earlier frame for a new beginning, so
        # that none is refused for being late.
        if abs(clock_s - self._clock_s) > 6.0:
            say(f"the clock of this machine was set by {clock_s - self._clock_s:+.0f} s")
            self._clock_s = clock_s
        return self._clock_s + moment

    def _pictures(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Yield seconds since the first frame, 0 for a device, and pixels."""
        if self._source.isdecimal():
            device = cv2.VideoCapture(int(self._source))
            while (read := device.read())[0] and not self._closed.is_set():
                yield 0.0, np.asarray(read[1], np.uint8)
            device.release()
            return
        with Path(self._source).open("rb") if self.is_file else nullcontext(self._source) as source:
            self._decoder = decoder = Decoder(source, interval_s=self._interval_s)
        try:
            for frame in decoder.frames():
                if self._closed.is_set():
                    return
                yield frame.timestamp, frame.pixels
        finally:
            complaint = decoder.close()
            if complaint and not self._closed.is_set():
                say(f"the source: {complaint}")
