"""The program that decodes pictures.

WebP, TIFF, GIF and BMP files of a few hundred kilobytes can take gigabytes and minutes, in ways
that no header shows. Here the system limits memory and processor time, and the service kills what
is late.
"""

import argparse
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

# NumPy imports this for percentiles, when a confined process can import no more.
import numpy.ma
from numpy.typing import NDArray
from PIL import Image

from app.decoding.confinement import confine, read_message, write_message
from app.scheduling.process import configure_process
from app.vision.images import (
    ImageError,
    ImageTooLargeError,
    configure_pillow,
    decode_image,
    read_size,
)
from app.vision.masks import decode_mask

TOO_EXPENSIVE = "the image is broken, or takes too much memory to decode"


def main() -> None:
    """Decode the pictures on standard input, after a message that says why seccomp is missing."""
    parser = argparse.ArgumentParser(description="Decode pictures for the service.")
    parser.add_argument("--max-seconds", type=int, required=True, help="of processor time, in all")
    parser.add_argument("--max-bytes", type=int, required=True, help="of memory")
    options = parser.parse_args()
    configure_process()
    configure_pillow()
    Image.init()  # Nothing can be imported later.
    missing = confine(options.max_seconds, options.max_bytes)
    with (
        os.fdopen(sys.stdin.fileno(), "rb", closefd=False) as source,
        os.fdopen(sys.stdout.fileno(), "wb", closefd=False) as out,
    ):
        write_message(out, {"missing": missing})

        def announce(pixels: int) -> None:
            write_message(out, {"pixels": pixels})
            read_message(source)  # It is the picture's turn.

        while asked := read_message(source):
            began = time.process_time()
            # When the time is over, this signal ends the process, whatever it is doing.
            signal.setitimer(signal.ITIMER_PROF, asked[0].pop("max_seconds"))
            found, values = answer(asked[1], announce, **asked[0])
            signal.setitimer(signal.ITIMER_PROF, 0)
            found["seconds"] = time.process_time() - began
            write_message(out, found, np.ascontiguousarray(values).data)


def answer(
    data: bytes, announce: Callable[[int], None], *, is_mask: bool, max_pixels: int
) -> tuple[dict[str, Any], NDArray[Any]]:
    """Decode a picture once ``announce`` has taken the pixels that its header gives.

    The first value has ``shape``, ``dtype`` and ``warnings`` of the second one, pixels or labels;
    or ``error`` and ``is_too_large``.
    """
    try:
        announce(math.prod(read_size(data, max_pixels)))
        values, warnings = _decode(data, max_pixels, is_mask)
    except ImageError as error:
        fields = {"error": str(error), "is_too_large": isinstance(error, ImageTooLargeError)}
        return fields, np.empty(0, np.uint8)
    return {"shape": values.shape, "dtype": values.dtype.str, "warnings": warnings}, values


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
