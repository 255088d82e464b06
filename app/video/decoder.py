"""The program that decodes a video, run in a process of its own.

FFmpeg reads the video. A hostile file can make it hang, crash or fill the memory. In a process of
its own it cannot harm the service, which kills it when it is late or no longer wanted. The program
is run by its path and writes a header before each frame, and another one at the end.
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

HEADER = Struct("<cIIIdd")
"""Kind, number of the frame, width, height, seconds since the video began, and width over height of
a pixel."""

FRAME, END, TOO_LARGE = b"F", b"E", b"L"
"""Kinds of headers: a frame, followed by its BGR pixels; the end, with the number of frames read
and, as width, the number in the file if some are missing; a frame of more pixels than allowed."""

# Playlists and image sequences are left out: they make FFmpeg open other files.
_FORMATS = "mov,matroska,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,h264,hevc,m4v,ivf,mjpeg,jpeg_pipe"
_OPTIONS = f"protocol_whitelist;file|format_whitelist;{_FORMATS}"

_MEMORY_BYTES = 640 * 1024**2
_NICENESS = 5
# A frame rate above the maximum is treated as wrong and replaced by the default.
_DEFAULT_FPS = 25.0
_MAX_FPS = 1000.0
_MAX_TIMESTAMP_S = 1e9
_MIN_PIXEL_ASPECT = 0.25
MIN_STEP_S = 1e-3
"""Least time between two frames; a camera session takes none that are closer."""
# A file may state a few frames more than any decoder finds.
_MAX_MISSING_SHARE = 0.05
_HEAD_BYTES = 2**16


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
    """Decode a file and write a header and the pixels of every ``stride``-th frame.

    A frame of more than ``max_pixels`` ends the output.
    """
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = _OPTIONS
    capture = cv2.VideoCapture(str(file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    clock = Clock(capture.get(cv2.CAP_PROP_FPS))
    width, height = _size(capture)
    aspect = _pixel_aspect(capture)
    number = 0
    while width * height <= max_pixels and capture.grab():
        timestamp = clock.timestamp(number, capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
        if number % stride == 0:
            read, picture = capture.retrieve()
            if not read:
                break
            height, width = picture.shape[:2]
            if width * height > max_pixels:
                break
            out.write(HEADER.pack(FRAME, number, width, height, timestamp, aspect))
            out.write(np.ascontiguousarray(picture).data)
            out.flush()
        number += 1
    if width * height > max_pixels:
        out.write(HEADER.pack(TOO_LARGE, number, width, height, 0.0, aspect))
    else:
        counted = _counted_frames(file, capture)
        # Where the rate varies, AVI counts a frame for each interval.
        reached = max(number, clock.intervals())
        missing = reached < counted * (1 - _MAX_MISSING_SHARE)
        out.write(HEADER.pack(END, number, counted if missing else 0, 0, 0.0, aspect))
    out.flush()


def _counted_frames(file: Path, capture: cv2.VideoCapture) -> int:
    """Number of frames that the file states; 0 if it is only estimated from the duration.

    MP4 and AVI state it, but fragmented MP4 does not.
    """
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    counts = head[8:12] == b"AVI " or (head[4:8] == b"ftyp" and b"mvex" not in head)
    return max(0, min(2**32 - 1, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))) if counts else 0


def _size(capture: cv2.VideoCapture) -> tuple[int, int]:
    """Width and height that the file announces, 0 if it announces none."""
    width, height = (
        max(0, int(capture.get(key)))
        for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    return width, height


def _pixel_aspect(capture: cv2.VideoCapture) -> float:
    """Width over height of a pixel; 1 unless the file announces a plausible one."""
    across, down = (capture.get(key) for key in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
    aspect = across / down if across > 0 and down > 0 else 1.0
    return aspect if _MIN_PIXEL_ASPECT <= aspect <= 1 / _MIN_PIXEL_ASPECT else 1.0


class Clock:
    """Ascending timestamps: the file's own or, if they do not ascend, from its frame rate."""

    def __init__(self, fps: float) -> None:
        self._interval_s = 1 / (fps if 0 < fps <= _MAX_FPS else _DEFAULT_FPS)
        self._last_s = -math.inf

    def timestamp(self, number: int, reported_s: float) -> float:
        """Seconds of a frame since the video began, given what the file reports."""
        if number == 0 and not reported_s > 0:
            self._last_s = 0.0
        elif self._last_s < reported_s < _MAX_TIMESTAMP_S:
            self._last_s = max(reported_s, self._last_s + MIN_STEP_S)
        else:
            self._last_s = max(self._last_s, 0.0) + self._interval_s
        return self._last_s

    def intervals(self) -> int:
        """Number of frames that there would be by now at the frame rate."""
        return 0 if self._last_s < 0 else round(self._last_s / self._interval_s) + 1


def _limit_process(max_seconds: int) -> None:
    """Limit the resources that a hostile file can make this process take."""
    os.nice(_NICENESS)
    for kind, limit in (
        (resource.RLIMIT_DATA, _MEMORY_BYTES),
        (resource.RLIMIT_CPU, max_seconds),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (limit if hard < 0 else min(limit, hard),) * 2)
    # If memory runs out, the kernel ends this process first.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


if __name__ == "__main__":
    main()
