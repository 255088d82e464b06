"""The program that decodes pictures, run in a process of its own.

WebP, TIFF, GIF and BMP files of a few hundred kilobytes can take gigabytes and minutes, in ways
that no header shows. In this process they cannot: memory and processor time are limited by the
system, and the service kills it when it is late. What the two write begins with two numbers: the
bytes of a JSON object, and those of the file or the pixels that follow it.
"""

import argparse
import json
import math
import os
import signal
import struct
import sys
import time
from collections.abc import Callable
from typing import Any, BinaryIO

import cv2
import numpy as np

# NumPy imports this for percentiles, when a confined process can import no more.
import numpy.ma
from numpy.typing import NDArray
from PIL import Image

from app.scheduling.process import configure_process
from app.video.confinement import forbid_system_calls, limit_resources
from app.vision.images import (
    ImageError,
    ImageTooLargeError,
    configure_pillow,
    decode_image,
    read_size,
)
from app.vision.masks import decode_mask

HEAD = struct.Struct(">II")
TOO_EXPENSIVE = "the image is broken, or takes too much memory to decode"


def main() -> None:
    """Decode the pictures on standard input, after an answer that says why seccomp is missing."""
    parser = argparse.ArgumentParser(description="Decode pictures for the service.")
    parser.add_argument("--max-seconds", type=int, required=True, help="of processor time, in all")
    parser.add_argument("--max-bytes", type=int, required=True, help="of memory")
    options = parser.parse_args()
    configure_process()
    configure_pillow()
    Image.init()  # Nothing can be imported later.
    limit_resources(options.max_seconds, options.max_bytes)
    missing = None
    try:
        forbid_system_calls()
    except OSError as error:
        missing = str(error)
    with (
        os.fdopen(sys.stdin.fileno(), "rb", closefd=False) as source,
        os.fdopen(sys.stdout.fileno(), "wb", closefd=False) as out,
    ):
        _write(out, {"missing": missing})

        def announce(pixels: int) -> None:
            _write(out, {"pixels": pixels})
            source.read(1)

        while head := source.read(HEAD.size):
            json_bytes, data_bytes = HEAD.unpack(head)
            asked = json.loads(source.read(json_bytes))
            _write(out, *answer(source.read(data_bytes), announce, **asked))


def answer(
    data: bytes,
    announce: Callable[[int], None],
    *,
    is_mask: bool,
    max_pixels: int,
    max_seconds: float,
) -> tuple[dict[str, Any], NDArray[Any]]:
    """Decode a picture, in so many seconds of processor time, or end the process.

    ``announce`` is called with the number of pixels that the header gives, and returns when it is
    the picture's turn. The first value has ``shape``, ``dtype`` and ``warnings`` of the second one,
    pixels or labels; or ``error`` and ``is_too_large``. It also has the ``seconds`` taken.
    """
    began, values = time.process_time(), np.empty(0, np.uint8)
    found: dict[str, Any]
    # When the time is over, this signal ends the process, whatever it is doing.
    signal.setitimer(signal.ITIMER_PROF, max_seconds)
    try:
        announce(math.prod(read_size(data, max_pixels)))
        values, warnings = _decode(data, max_pixels, is_mask)
        found = {"shape": values.shape, "dtype": values.dtype.str, "warnings": warnings}
    except ImageError as error:
        found = {"error": str(error), "is_too_large": isinstance(error, ImageTooLargeError)}
    signal.setitimer(signal.ITIMER_PROF, 0)
    return found | {"seconds": time.process_time() - began}, values


def _write(out: BinaryIO, found: dict[str, Any], values: NDArray[Any] | None = None) -> None:
    head = json.dumps(found).encode()
    out.write(HEAD.pack(len(head), 0 if values is None else values.nbytes) + head)
    if values is not None:
        out.write(np.ascontiguousarray(values).data)
    out.flush()


def _decode(data: bytes, max_pixels: int, is_mask: bool) -> tuple[NDArray[Any], tuple[str, ...]]:
    try:
        if is_mask:
            return decode_mask(data, max_pixels=max_pixels).labels, ()
        photograph = decode_image(data, max_pixels=max_pixels)
        return photograph.pixels, photograph.warnings
    except (MemoryError, cv2.error) as error:
        raise ImageError(TOO_EXPENSIVE) from error


if __name__ == "__main__":
    main()
