"""Encoded images and label masks to pixels.

A PNG of 389 KB can hold 20,000 x 20,000 pixels, which take seconds and gigabytes to decode, so
format and size are read from the header first.
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

from app.vision.parameters import DEFAULTS, ImageParameters

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")

Labels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]

# The limit is the caller's, which may be higher.
Image.MAX_IMAGE_PIXELS = None
# Pillow warns of each odd tag.
warnings.filterwarnings("ignore", module="PIL")


class ImageError(ValueError):
    """The bytes are not an image that can be used; the message is one clear sentence."""


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
        First column and row of the part.
    part : (h, w) array
        The smallest part that holds all labels: most of a mask is background.
    """

    labels: Labels
    present: list[int]
    left: int
    top: int
    part: Labels

    @classmethod
    def of(cls, labels: Labels) -> LabelImage:
        """Find the labels of an array ``(H, W)``."""
        if labels.ndim != 2:
            raise ValueError(f"expected labels of shape (H, W), got {labels.shape}")
        # `boundingRect` takes no 16 bits.
        marked = labels if labels.dtype == np.uint8 else np.asarray(labels != 0).view(np.uint8)
        left, top, width, height = cv2.boundingRect(marked)
        part = labels[top : top + height, left : left + width].copy()
        return cls(labels, _labels_in(part), left, top, part)

    def merged(self) -> LabelImage:
        """The same image with all labels merged into one person, label 1."""
        labels, part = ((image != 0).view(np.uint8) for image in (self.labels, self.part))
        return LabelImage(labels, [1] if self.present else [], self.left, self.top, part)


def _labels_in(part: Labels) -> list[int]:
    """The labels in a part ``(h, w)`` in one piece, ascending, without 0."""
    # Several times as fast as np.unique or np.bincount.
    if part.size == 0:
        return []
    bins = int(part.max()) + 1
    counts = cv2.calcHist([part], [0], None, [bins], [0, bins])
    return (np.flatnonzero(counts[1:]) + 1).tolist()


def decode_image(data: bytes, *, max_pixels: int) -> NDArray[np.uint8]:
    """Decode a photograph.

    The EXIF orientation is applied. Grey images get three equal channels, CMYK becomes BGR,
    16 bits become 8, an alpha channel is dropped, and an animation gives its first picture.

    Returns
    -------
    (H, W, 3) uint8 array
        BGR.

    Raises
    ------
    ImageTooLargeError
        If the header says that the image has more than ``max_pixels`` pixels.
    ImageError
        If the bytes are no image of :data:`FORMATS`, or a broken one.
    """
    header = _checked_header(data, max_pixels)
    return _decode(data, header.format, cv2.IMREAD_COLOR).astype(np.uint8, copy=False)


def decode_mask(
    data: bytes, *, max_pixels: int, parameters: ImageParameters = DEFAULTS.images
) -> LabelImage:
    """Decode a label image: 0 is background, k is person k.

    Grey and palette images keep their stored values, whatever their bit depth; of a palette image
    the indices count, not the colours. An image of two values, 0 and any other, is one person,
    label 1. So is an image of lossy compression (JPEG, WebP), which cannot keep labels: values from
    128 up are the person. Three channels are accepted where they are equal. The EXIF orientation is
    applied and an alpha channel dropped.

    Raises
    ------
    ImageTooLargeError, ImageError
        As :func:`decode_image`, and if the image is coloured or holds more than 100 labels.
    """
    header = _checked_header(data, max_pixels)
    if header.format == "PNG" and header.mode == "P":
        labels: Labels = _palette_indices(data)
    else:
        pixels = _decode(data, header.format, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
        if is_lossy(header, data):
            labels = _one_channel(pixels, parameters.lossy_channel_difference)
            return LabelImage.of(np.asarray(labels >= parameters.lossy_threshold).view(np.uint8))
        labels = _one_channel(pixels, 0)
        if header.format == "PNG" and header.mode == "L":
            # OpenCV stretches 2 and 4 bits to 0..255; the 25th byte of a PNG is its bit depth.
            labels = labels // {2: 85, 4: 17}.get(data[24], 1)
    image = LabelImage.of(labels)
    if len(image.present) == 1 and image.present != [1]:
        return image.merged()
    if len(image.present) > parameters.max_labels:
        raise ImageError(
            f"expected a mask of at most {parameters.max_labels} labels, got {len(image.present)}: "
            "a mask with soft edges must be thresholded first"
        )
    return image


def read_header(data: bytes, parameters: ImageParameters = DEFAULTS.images) -> Image.Image:
    """Read format and size, as stored, without decoding the image.

    Raises
    ------
    ImageError
        If the bytes are empty, of none of :data:`FORMATS`, or end within the header.
    """
    if not data:
        raise ImageError("expected an image, got no bytes")
    try:
        return Image.open(_LimitedReads(data, parameters), formats=FORMATS)
    except ImageError:
        raise
    except Exception as error:  # Damaged headers make Pillow raise almost anything.
        raise ImageError(
            "expected a PNG, JPEG, WebP, BMP, TIFF or GIF image, got something else or a broken one"
        ) from error


class _LimitedReads(io.BytesIO):
    """Encoded bytes of which the number of reads is limited."""

    def __init__(self, data: bytes, parameters: ImageParameters) -> None:
        super().__init__(data)
        self._reads_left = parameters.free_reads + len(data) // parameters.bytes_per_read

    def read(self, size: int | None = -1, /) -> bytes:
        self._reads_left -= 1
        if self._reads_left < 0:
            raise ImageError("expected an image, got one of too many segments")
        return super().read(size)


def _checked_header(data: bytes, max_pixels: int) -> Image.Image:
    """Read a header; raise :class:`ImageError` if the image should not be decoded."""
    header = read_header(data)
    if header.width * header.height > max_pixels:
        raise ImageTooLargeError(
            f"expected at most {max_pixels} pixels, got {header.width}x{header.height}"
        )
    if header.format == "PNG":
        # OpenCV allocates what a chunk announces: two gigabytes for a file of a kilobyte.
        try:
            Image.open(_LimitedReads(data, DEFAULTS.images), formats=("PNG",)).verify()
        except Exception as error:
            raise ImageError("the PNG image is broken") from error
    return header


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


def _decode(data: bytes, format_name: str | None, flags: int) -> NDArray[Any]:
    """Decode with OpenCV, which fails in two ways."""
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"the {format_name} image is broken") from error
    if pixels is None:
        raise ImageError(f"the {format_name} image is broken")
    return pixels


def _palette_indices(data: bytes) -> NDArray[np.uint8]:
    """Stored values ``(H, W)`` of a PNG with a palette, which OpenCV replaces by colours."""
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            return np.asarray(ImageOps.exif_transpose(image))
    except Exception as error:  # Damaged data make Pillow raise almost anything.
        raise ImageError("the PNG image is broken") from error


def _one_channel(pixels: NDArray[Any], max_difference: int) -> Labels:
    """Values ``(H, W)`` of an image of one channel, or of three that differ by no more."""
    if not np.issubdtype(pixels.dtype, np.unsignedinteger):
        raise ImageError(f"expected a mask of whole numbers, got {pixels.dtype} values")
    if pixels.ndim == 3:
        if int(np.ptp(pixels.astype(np.int32), axis=2).max()) > max_difference:
            raise ImageError("expected a mask of one channel or of equal ones, got a coloured one")
        pixels = pixels[:, :, 0]
    return pixels if pixels.dtype == np.uint8 else pixels.astype(np.uint16, copy=False)
