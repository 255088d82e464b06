"""The program that decodes a video or a camera's stream, run in a process of its own.

A hostile file can make FFmpeg hang, crash, fill the memory or run code. In this process it cannot
harm the service, or the bridge that holds passwords, which kill it when it is late or no longer
wanted. The program writes, for each frame, a line of JSON and its BGR pixels, and at the end
another line.
"""

import argparse
import json
import os
import sys
from contextlib import suppress
from typing import BinaryIO

from app.video.confinement import forbid_system_calls, limit_resources
from app.video.frames import TooLargeError, UnreadableError, Video
from app.video.stream import reachable

# Playlists and image sequences are left out: they make FFmpeg open other files.
_FORMATS = (
    "mov,matroska,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,h264,hevc,m4v,ivf,mjpeg,jpeg_pipe,gif,dv"
)
_OPTIONS = {"format_whitelist": _FORMATS}

STREAM_TIMEOUT_S = 10.0
"""Longest time for which a stream may send nothing."""
_MEMORY_BYTES = 640 * 1024**2
_NICENESS = 5


def main() -> None:
    """Write the frames of an open file to standard output."""
    parser = argparse.ArgumentParser(description="Decode a video for the service.")
    parser.add_argument(
        "file", type=int, nargs="?", help="its descriptor; the address of a stream comes as input"
    )
    parser.add_argument("--stride", type=int, default=1, help="take every n-th frame")
    parser.add_argument("--max-pixels", type=int, required=True, help="of a frame")
    parser.add_argument("--max-seconds", type=int, required=True, help="of processor time")
    parser.add_argument("--interval", type=float, default=0.0, help="least time between two frames")
    options = parser.parse_args()
    is_stream, opening = options.file is None, _OPTIONS
    source: str | BinaryIO
    if is_stream:
        # Not an argument, which other users of the machine see: it may hold a password.
        try:
            source, opening = reachable(sys.stdin.readline().rstrip("\n"), STREAM_TIMEOUT_S)
        except (OSError, ValueError):  # Which may name a part of the address.
            sys.exit(1)
    else:
        source = os.fdopen(options.file, "rb", buffering=0)
    os.nice(_NICENESS)
    limit_resources(options.max_seconds, _MEMORY_BYTES, network=is_stream)
    try:
        forbid_system_calls(network=is_stream)
    except OSError as error:
        print(f"a video is decoded without seccomp: {error}", file=sys.stderr)
    with suppress(BrokenPipeError), os.fdopen(sys.stdout.fileno(), "wb", closefd=False) as out:
        write_frames(source, options.stride, options.max_pixels, out, opening, options.interval)


def write_frames(
    source: str | BinaryIO,
    stride: int,
    max_pixels: int,
    out: BinaryIO,
    opening: dict[str, str] = _OPTIONS,
    interval_s: float = 0.0,
) -> None:
    """Decode a file, or a stream by its address; see :meth:`app.video.frames.Video.frames`.

    The line before a frame's pixels has ``width``, ``height``, and the other fields of
    :class:`app.video.Frame`. The last line has ``end``: null if the video is complete,
    what was found if not. If a frame has more than ``max_pixels``, the last line is its size.
    """

    def write(**fields: object) -> None:
        out.write(json.dumps(fields).encode() + b"\n")
        out.flush()

    try:
        timeout_s = STREAM_TIMEOUT_S if isinstance(source, str) else None
        video = Video(source, opening, timeout_s)
        for frame in video.frames(stride, max_pixels, interval_s):
            fields = frame._asdict()
            height, width = fields.pop("pixels").shape[:2]
            write(width=width, height=height, **fields)
            out.write(frame.pixels.data)
        write(end=None)
    except TooLargeError as error:
        write(width=error.width, height=error.height)
    except UnreadableError as error:
        write(end=str(error))


if __name__ == "__main__":
    main()
