"""Format and size of an encoded image from its first bytes, without decoding it.

A 389 KB PNG can hold 20,000 x 20,000 pixels, which take seconds and gigabytes to decode;
its header gives it away in microseconds.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass


class ImageError(ValueError):
    """The bytes are not an image that can be used; the message is one clear sentence."""


@dataclass(frozen=True)
class ImageHeader:
    """What the first bytes of an image promise.

    Parameters
    ----------
    format : str
        ``png``, ``jpeg``, ``webp``, ``bmp``, ``tiff`` or ``gif``.
    width, height : int
        Stored size in pixels, before any EXIF orientation.
    lossy : bool
        Whether the format may alter pixel values.
    """

    format: str
    width: int
    height: int
    lossy: bool = False

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ImageError(
                f"expected a {self.format} image with pixels, got {self.width}x{self.height}"
            )


def read_header(data: bytes) -> ImageHeader:
    """Read format and size.

    Parameters
    ----------
    data : bytes
        The encoded image, or at least its head.

    Returns
    -------
    ImageHeader

    Raises
    ------
    ImageError
        If the bytes are empty, of no known format, or end within the header.
    """
    if not data:
        raise ImageError("expected an image, got no bytes")
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return _png(data)
        if data.startswith(b"\xff\xd8\xff"):
            return _jpeg(data)
        if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _webp(data)
        if data.startswith((b"II*\0", b"MM\0*")):
            return _tiff(data)
        if data.startswith((b"GIF87a", b"GIF89a")):
            return ImageHeader("gif", *struct.unpack_from("<HH", data, 6))
        if data.startswith(b"BM"):
            return _bmp(data)
    except (struct.error, IndexError) as error:
        raise ImageError("the image ends before its header does") from error
    raise ImageError("expected a PNG, JPEG, WebP, BMP, TIFF or GIF image, got something else")


def _png(data: bytes) -> ImageHeader:
    if data[12:16] != b"IHDR":
        raise ImageError("the PNG image does not start with its header chunk")
    return ImageHeader("png", *struct.unpack_from(">II", data, 16))


def _jpeg(data: bytes) -> ImageHeader:
    position = 2
    while True:
        if data[position] != 0xFF:
            raise ImageError("the JPEG image has no frame header")
        marker = data[position + 1]
        if marker == 0xFF:  # a fill byte
            position += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:  # markers without a length
            position += 2
        elif marker in (0xD9, 0xDA):  # picture data, or its end, before a frame header
            raise ImageError("the JPEG image has no frame header")
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, position + 5)
            return ImageHeader("jpeg", width, height, lossy=True)
        else:
            position += 2 + struct.unpack_from(">H", data, position + 2)[0]


def _webp(data: bytes) -> ImageHeader:
    kind = data[12:16]
    if kind == b"VP8X":
        width = 1 + int.from_bytes(_exactly(data, 24, 3), "little")
        height = 1 + int.from_bytes(_exactly(data, 27, 3), "little")
        return ImageHeader("webp", width, height, lossy=b"VP8L" not in data[30:])
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", data, 21)[0]
        return ImageHeader("webp", 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF))
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return ImageHeader("webp", width & 0x3FFF, height & 0x3FFF, lossy=True)
    raise ImageError("the WebP image has no frame header")


def _bmp(data: bytes) -> ImageHeader:
    if struct.unpack_from("<I", data, 14)[0] == 12:  # the header of OS/2 1.x
        return ImageHeader("bmp", *struct.unpack_from("<HH", data, 18))
    width, height = struct.unpack_from("<ii", data, 18)
    return ImageHeader("bmp", width, abs(height))  # negative height: stored from the top


def _tiff(data: bytes) -> ImageHeader:
    order = "<" if data[:2] == b"II" else ">"
    directory = struct.unpack_from(order + "I", data, 4)[0]
    sizes: dict[int, int] = {}
    compression = 1
    for entry in range(struct.unpack_from(order + "H", data, directory)[0]):
        position = directory + 2 + 12 * entry
        tag, kind = struct.unpack_from(order + "HH", data, position)
        if tag in (256, 257, 259):
            value = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, position + 8)[0]
            if tag == 259:
                compression = value
            else:
                sizes[tag] = value
    if len(sizes) < 2:
        raise ImageError("the TIFF image does not say its size")
    return ImageHeader("tiff", sizes[256], sizes[257], lossy=compression in (6, 7))


def _exactly(data: bytes, start: int, count: int) -> bytes:
    """Return ``count`` bytes from ``start``, or raise IndexError."""
    part = data[start : start + count]
    if len(part) < count:
        raise IndexError(start)
    return part
