"""The frames of a video, decoded in a process of its own, whose program this is.

Videos are read by FFmpeg's parsers and decoders, which a hostile file can make hang, crash or fill
the memory. In a process of their own they cannot harm the service, which kills them when they are
late or no longer wanted. A header comes before each frame, and another one at the end.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import sys
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import BinaryIO

import cv2
import numpy as np

HEADER = Struct("<cIIId")
"""Kind, number of the frame, width, height, and seconds since the video began."""

FRAME, END, TOO_LARGE = b"F", b"E", b"L"
"""Kinds of headers: a frame, followed by its BGR pixels; the end, with the number of frames that
were read and, as width, of those that the file announces; a frame of more pixels than allowed."""

# Playlists and series of images would have FFmpeg open other files.
_FORMATS = "mov,matroska,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,h264,hevc,m4v,ivf"
_OPTIONS = f"protocol_whitelist;file|format_whitelist;{_FORMATS}"

_MEMORY_BYTES = 640 * 1024**2
_NICENESS = 5
_USUAL_FPS = 25.0
_HIGHEST_FPS = 1000.0


def main() -> None:
    """Write the frames of a file to standard output."""
    parser = argparse.ArgumentParser(description="Decode a video for the service.")
    parser.add_argument("file", type=Path)
    parser.add_argument("--stride", type=int, default=1, help="take every n-th frame")
    parser.add_argument("--max-pixels", type=int, required=True, help="of a frame")
    parser.add_argument("--max-seconds", type=int, required=True, help="of processor time")
    options = parser.parse_args()
    _limit_process(options.max_seconds)
    with suppress(BrokenPipeError), open(sys.stdout.fileno(), "wb", closefd=False) as out:
        write_frames(options.file, options.stride, options.max_pixels, out)


def write_frames(file: Path, stride: int, max_pixels: int, out: BinaryIO) -> None:
    """Decode a file and write headers and frames.

    Parameters
    ----------
    file : Path
    stride : int
        Every n-th frame is written.
    max_pixels : int
        Of a frame; a larger one is the end.
    out : binary file
    """
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = _OPTIONS
    capture = cv2.VideoCapture(str(file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    clock = _Clock(capture.get(cv2.CAP_PROP_FPS))
    width, height = _size(capture)
    number = 0
    while width * height <= max_pixels and capture.grab():
        timestamp = clock.of_frame(number, capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
        if number % stride == 0:
            read, picture = capture.retrieve()
            if not read:
                break
            height, width = picture.shape[:2]
            if width * height > max_pixels:
                break
            out.write(HEADER.pack(FRAME, number, width, height, timestamp))
            out.write(np.ascontiguousarray(picture).data)
            out.flush()
        number += 1
    if width * height > max_pixels:
        out.write(HEADER.pack(TOO_LARGE, number, width, height, 0.0))
    else:
        announced = max(0, min(2**32 - 1, int(capture.get(cv2.CAP_PROP_FRAME_COUNT))))
        out.write(HEADER.pack(END, number, announced, 0, 0.0))
    out.flush()


def _size(capture: cv2.VideoCapture) -> tuple[int, int]:
    """Return width and height as the file announces them, 0 if it does not."""
    return (
        max(0, int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))),
        max(0, int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))),
    )


class _Clock:
    """Timestamps that ascend: the file's own, or by the frame rate where they do not.

    Parameters
    ----------
    fps : float
        Frames a second as the file says; it may be anything.
    """

    def __init__(self, fps: float) -> None:
        self._interval_s = 1 / (fps if 0 < fps <= _HIGHEST_FPS else _USUAL_FPS)
        self._last_s = -math.inf

    def of_frame(self, number: int, told_s: float) -> float:
        """Return the seconds of a frame, given what the file tells."""
        if number == 0 and not told_s > 0:
            self._last_s = 0.0
        elif math.isfinite(told_s) and self._last_s < told_s < 1e9:
            self._last_s = told_s
        else:
            self._last_s = max(self._last_s, 0.0) + self._interval_s
        return self._last_s


def _limit_process(max_seconds: int) -> None:
    """Bound what a hostile file can have this process take."""
    os.nice(_NICENESS)
    for kind, limit in (
        (resource.RLIMIT_DATA, _MEMORY_BYTES),
        (resource.RLIMIT_CPU, max_seconds),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        _, most = resource.getrlimit(kind)
        resource.setrlimit(kind, (limit if most < 0 else min(limit, most),) * 2)
    # If memory runs out, it is this process that ends.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


if __name__ == "__main__":
    main()
