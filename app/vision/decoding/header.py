"""Format and size of an encoded image from its header, without decoding it.

A 389 KB PNG can hold 20,000 x 20,000 pixels, which take seconds and gigabytes to decode; its
header gives it away.
"""

from __future__ import annotations

import io
import warnings

# Imported here, since for a format it does not know yet Pillow imports all its plugins.
from PIL import (  # noqa: F401
    BmpImagePlugin,
    GifImagePlugin,
    Image,
    JpegImagePlugin,
    PngImagePlugin,
    TiffImagePlugin,
    WebPImagePlugin,
)

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")

# The caller's limit counts, which may be higher.
Image.MAX_IMAGE_PIXELS = None
# About odd tags, a line for each.
warnings.filterwarnings("ignore", module="PIL")


class ImageError(ValueError):
    """The bytes are not an image that can be used; the message is one clear sentence."""


class _Source(io.BytesIO):
    """Encoded bytes, which may be read in pieces of 500 bytes on average, and 10,000 more.

    Pillow reads every segment by itself and keeps it: a JPEG of 16 MB of empty ones would take it
    ten seconds and 700 MB.
    """

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._reads_left = 10_000 + len(data) // 500

    def read(self, size: int | None = -1, /) -> bytes:
        self._reads_left -= 1
        if self._reads_left < 0:
            raise ImageError("expected an image, got one of too many segments")
        return super().read(size)


def read_header(data: bytes) -> Image.Image:
    """Read format and size.

    Parameters
    ----------
    data : bytes
        PNG, JPEG, WebP, BMP, TIFF or GIF.

    Returns
    -------
    PIL.Image.Image
        Not loaded; ``size`` is the stored one, before any EXIF orientation.

    Raises
    ------
    ImageError
        If the bytes are empty, of no known format, or end within the header.
    """
    if not data:
        raise ImageError("expected an image, got no bytes")
    try:
        return Image.open(_Source(data), formats=FORMATS)
    except ImageError:
        raise
    except Exception as error:  # Damaged headers make Pillow raise almost anything.
        raise ImageError(
            "expected a PNG, JPEG, WebP, BMP, TIFF or GIF image, got something else or a broken one"
        ) from error


def check_chunks(data: bytes) -> None:
    """Raise :class:`ImageError` for a PNG with a chunk that is damaged or does not end within it.

    OpenCV believes what a chunk announces: it sets two gigabytes aside for a file of a kilobyte.
    """
    try:
        Image.open(_Source(data), formats=("PNG",)).verify()
    except Exception as error:
        raise ImageError("the PNG image is broken") from error


def is_lossy(image: Image.Image, data: bytes) -> bool:
    """Whether the compression of an image may alter pixel values."""
    match image.format:
        case "JPEG" | "MPO":
            return True
        case "WEBP":
            return b"VP8L" not in data
        case "TIFF":
            return image.info.get("compression") in ("jpeg", "tiff_jpeg")
    return False
