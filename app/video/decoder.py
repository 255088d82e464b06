"""The program that decodes a video, run in a process of its own.

A hostile file can make FFmpeg hang, crash, fill the memory or run code. In this process it cannot
harm the service, which kills it when it is late or no longer wanted. The program writes, for each
frame, a line of JSON and its BGR pixels, and at the end another line.
"""

import argparse
import json
import os
import sys
from contextlib import suppress
from typing import BinaryIO

from app.video.confinement import forbid_system_calls, limit_resources
from app.video.frames import TooLargeError, UnreadableError, Video

# Playlists and image sequences are left out: they make FFmpeg open other files.
_FORMATS = (
    "mov,matroska,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,h264,hevc,m4v,ivf,mjpeg,jpeg_pipe,gif,dv"
)
_OPTIONS = {"format_whitelist": _FORMATS}

_MEMORY_BYTES = 640 * 1024**2
_NICENESS = 5


def main() -> None:
    """Write the frames of an open file to standard output."""
    parser = argparse.ArgumentParser(description="Decode a video for the service.")
    parser.add_argument("file", type=int, help="descriptor of the file")
    parser.add_argument("--stride", type=int, default=1, help="take every n-th frame")
    parser.add_argument("--max-pixels", type=int, required=True, help="of a frame")
    parser.add_argument("--max-seconds", type=int, required=True, help="of processor time")
    options = parser.parse_args()
    os.nice(_NICENESS)
    limit_resources(options.max_seconds, _MEMORY_BYTES)
    try:
        forbid_system_calls()
    except OSError as error:
        print(f"a video is decoded without seccomp: {error}", file=sys.stderr)
    with (
        suppress(BrokenPipeError),
        os.fdopen(options.file, "rb", buffering=0) as file,
        os.fdopen(sys.stdout.fileno(), "wb", closefd=False) as out,
    ):
        write_frames(file, options.stride, options.max_pixels, out)


def write_frames(file: BinaryIO, stride: int, max_pixels: int, out: BinaryIO) -> None:
    """Decode a file and write every ``stride``-th frame.

    The line before a frame's pixels has ``width``, ``height``, and the other fields of
    :class:`app.video.Frame`. The last line has ``end``: null if the video is complete,
    what was found if not. If a frame has more than ``max_pixels``, the last line is its size.
    """

    def write(**fields: object) -> None:
        out.write(json.dumps(fields).encode() + b"\n")
        out.flush()

    try:
        for frame in Video(file, _OPTIONS).frames(stride, max_pixels):
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
