"""Encoded images and label masks to pixels.

A 389 KB PNG can hold 20,000 x 20,000 pixels, which take seconds and gigabytes to decode: format and
size are read from the header first.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import (  # noqa: F401
    BmpImagePlugin,
    GifImagePlugin,
    Image,
    ImageOps,
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


__all__ = ["ImageError", "ImageTooLargeError", "LabelImage", "decode_image", "decode_mask"]

Labels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

# A label image with more different values than this is a mask with soft edges, not a crowd.
MAX_LABELS = 100


class ImageTooLargeError(ImageError):
    """The image has more pixels than allowed."""


@dataclass(frozen=True)
class LabelImage:
    """Where people are: 0 is background, k is person k.

    Parameters
    ----------
    labels : (H, W) array of uint8 or uint16
    present : list of int
        The labels it holds, ascending, without 0.
    left, top : int
        Where the part begins.
    part : (h, w) array
        What is within the borders of all labels: most of a mask is background.
    """

    labels: Labels
    present: list[int]
    left: int
    top: int
    part: Labels

    @classmethod
    def of(cls, labels: Labels) -> LabelImage:
        """Look for labels.

        Raises
        ------
        ValueError
            If the array is not two-dimensional.
        """
        if labels.ndim != 2:
            raise ValueError(f"expected labels of shape (H, W), got {labels.shape}")
        # OpenCV has no bounds of 16 bits.
        marked = labels if labels.dtype == np.uint8 else np.asarray(labels != 0).view(np.uint8)
        left, top, width, height = cv2.boundingRect(marked)
        part = labels[top : top + height, left : left + width].copy()
        return cls(labels, _labels_in(part), left, top, part)

    def of_one(self) -> LabelImage:
        """Take all labels for the same person's, number 1."""
        labels, part = ((image != 0).view(np.uint8) for image in (self.labels, self.part))
        return LabelImage(labels, [1] if self.present else [], self.left, self.top, part)


def decode_image(data: bytes, *, max_pixels: int) -> NDArray[np.uint8]:
    """Decode a photograph.

    The EXIF orientation is applied. Grey images get three equal channels, CMYK becomes BGR,
    16 bits become 8, an alpha channel is dropped, of an animation the first picture counts.

    Parameters
    ----------
    data : bytes
        PNG, JPEG, WebP, BMP, TIFF or GIF.
    max_pixels : int
        Width times height allowed; checked on the header, before anything is decoded.

    Returns
    -------
    (H, W, 3) uint8 array
        BGR.

    Raises
    ------
    ImageTooLargeError
        If the image has more than ``max_pixels`` pixels.
    ImageError
        If the bytes are no image, or a broken one.
    """
    header = _checked_header(data, max_pixels)
    return _decode(data, header.format, cv2.IMREAD_COLOR).astype(np.uint8, copy=False)


def decode_mask(data: bytes, *, max_pixels: int) -> LabelImage:
    """Decode a label image: 0 is background, k is person k.

    Grey and palette images keep their stored values exactly, whatever their bit depth (of a
    palette image the index counts, not the colour). An image of two values, 0 and any other,
    is one person, label 1; so is an image of lossy compression (JPEG, WebP), which cannot
    keep labels: there, values from 128 up are the person. EXIF orientation is applied, as it
    is to the frame; an alpha channel is dropped.

    Parameters
    ----------
    data : bytes
        As in :func:`decode_image`; three channels are accepted where they are equal.
    max_pixels : int
        Width times height allowed.

    Returns
    -------
    LabelImage

    Raises
    ------
    ImageTooLargeError
        If the image has more than ``max_pixels`` pixels.
    ImageError
        If the bytes are no image, the image is coloured, or it holds more than 100 labels.
    """
    header = _checked_header(data, max_pixels)
    if header.format == "PNG" and header.mode == "P":
        labels: Labels = _palette_indices(data)
    else:
        pixels = _decode(data, header.format, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
        lossy = is_lossy(header, data)
        labels = _one_channel(pixels, tolerance=16 if lossy else 0)
        if lossy:
            return LabelImage.of(np.asarray(labels >= 128).view(np.uint8))
        if header.format == "PNG" and header.mode == "L":
            # OpenCV stretches 2 and 4 bits to 0..255; the 25th byte of a PNG is its bit depth.
            labels = labels // {2: 85, 4: 17}.get(data[24], 1)
    image = LabelImage.of(labels)
    if len(image.present) == 1 and image.present != [1]:
        return image.of_one()
    if len(image.present) > MAX_LABELS:
        raise ImageError(
            f"expected a mask of at most {MAX_LABELS} labels, got {len(image.present)}: "
            "a mask with soft edges must be thresholded first"
        )
    return image


def _labels_in(part: Labels) -> list[int]:
    """The labels of a part of a label image ``(h, w)`` in one piece, ascending, without 0."""
    # Several times as fast as np.unique or np.bincount, and the more so the less there is to count.
    if part.size == 0:
        return []
    bins = int(part.max()) + 1
    counts = cv2.calcHist([part], [0], None, [bins], [0, bins])
    return (np.flatnonzero(counts[1:]) + 1).tolist()


def _checked_header(data: bytes, max_pixels: int) -> Image.Image:
    header = read_header(data)
    if header.width * header.height > max_pixels:
        raise ImageTooLargeError(
            f"expected at most {max_pixels} pixels, got {header.width}x{header.height}"
        )
    if header.format == "PNG":
        check_chunks(data)
    return header


def _decode(data: bytes, form: str | None, flags: int) -> NDArray[Any]:
    """Decode with OpenCV, turning its two ways to fail into one."""
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"the {form} image is broken") from error
    if pixels is None:
        raise ImageError(f"the {form} image is broken")
    return pixels


def _palette_indices(data: bytes) -> NDArray[np.uint8]:
    """Stored values ``(H, W)`` of a PNG with a palette, which OpenCV replaces by colours."""
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            return np.asarray(ImageOps.exif_transpose(image))
    except Exception as error:  # Damaged data make Pillow raise almost anything.
        raise ImageError("the PNG image is broken") from error


def _one_channel(pixels: NDArray[Any], tolerance: int) -> Labels:
    """Values ``(H, W)`` of an image of one channel, or of three that differ by no more."""
    if not np.issubdtype(pixels.dtype, np.unsignedinteger):
        raise ImageError(f"expected a mask of whole numbers, got {pixels.dtype} values")
    if pixels.ndim == 3:
        if int(np.ptp(pixels.astype(np.int32), axis=2).max()) > tolerance:
            raise ImageError("expected a mask of one channel or of equal ones, got a coloured one")
        pixels = pixels[:, :, 0]
    return pixels if pixels.dtype == np.uint8 else pixels.astype(np.uint16, copy=False)
