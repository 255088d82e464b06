"""Grey PNGs of 8 bits, the masks that callers send, several times as fast as OpenCV reads them.

A mask is nearly empty. OpenCV spends most of its time on what only other PNGs need; here rows
without a person cost next to nothing. Whatever is out of the ordinary is left to OpenCV.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from app.vision.png_chunks import png_chunks

_HEADER = struct.Struct(">IIBBBBB")
_NONE, _SUB, _UP = range(3)


def read_grey_png(data: bytes) -> NDArray[np.uint8] | None:
    """Decode a PNG of one channel of 8 bits, not interlaced, without orientation.

    Parameters
    ----------
    data : bytes
        A PNG whose chunks end within the file.

    Returns
    -------
    (H, W) uint8 array or None
        None for any other PNG, for a broken one, and where rows are predicted from both
        neighbours, which takes a loop over pixels.
    """
    compressed: list[memoryview] = []
    shape: tuple[int, int] | None = None
    for chunk in png_chunks(data):
        if zlib_ng.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:], "big"):
            return None
        kind, content = bytes(chunk[4:8]), chunk[8:-4]
        if kind == b"IHDR" and len(content) == _HEADER.size:
            width, height, *rest = _HEADER.unpack(content)
            if rest != [8, 0, 0, 0, 0]:
                return None
            shape = (height, width)
        elif kind == b"IDAT":
            compressed.append(content)
        elif kind in (b"eXIf", b"tRNS", b"acTL") or (kind != b"IEND" and kind[:1].isupper()):
            return None
    return None if shape is None else _unfiltered(b"".join(compressed), *shape)


def _unfiltered(compressed: bytes, height: int, width: int) -> NDArray[np.uint8] | None:
    size = height * (width + 1)
    inflater = zlib_ng.decompressobj()
    try:
        # One byte more than there should be tells a stream that is too long.
        content = inflater.decompress(compressed, size + 1)
    except zlib_ng.error:  # type: ignore[misc]  # Declared as if it were an instance.
        return None
    if len(content) != size or not inflater.eof:
        return None
    rows = np.frombuffer(content, np.uint8).reshape(height, width + 1)
    filters, pixels = rows[:, 0], rows[:, 1:].copy()
    if filters.max() > _UP:
        return None
    # Nothing differs from its neighbour outside this.
    left, top, wide, high = cv2.boundingRect(pixels)
    beside = top + np.flatnonzero(filters[top : top + high] == _SUB)
    if len(beside):
        sums = np.add.accumulate(pixels[beside, left : left + wide], axis=1, dtype=np.uint8)
        pixels[beside, left : left + wide] = sums
        pixels[beside, left + wide :] = sums[:, -1:]
    # Above the first row all is zero.
    below = np.flatnonzero(filters[1:] == _UP) + 1
    for run in np.split(below, np.flatnonzero(np.diff(below) > 1) + 1):
        if len(run):
            block = slice(run[0] - 1, run[-1] + 1)
            pixels[block] = np.add.accumulate(pixels[block], axis=0, dtype=np.uint8)
    return pixels
