"""Encoded images: photographs become pixels, masks become labels of people.

A PNG of 389 KB can hold 20,000 x 20,000 pixels, which take seconds and gigabytes to decode, so
format and size are read from the header first.
"""

from __future__ import annotations

import io
import math
import warnings
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from app.vision.geometry import Box

# The caller's limit applies instead; it may be higher.
Image.MAX_IMAGE_PIXELS = None
# Pillow warns about each unusual tag.
warnings.filterwarnings("ignore", module="PIL")

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")

ImageWarning = Literal["dark", "stretched", "truncated", "damaged", "zone_outside"]
"""``dark``: the picture is too dark to show much; ``stretched``: a 16-bit image used only part of
its range, which was stretched; ``truncated``: the end of the image is missing; ``damaged``: a frame
of a video whose data is incomplete or wrong; ``zone_outside``: a zone of the camera lies outside
the frame."""


class ImageError(ValueError):
    """The bytes are not a usable image; the message is one sentence."""


class ImageTooLargeError(ImageError):
    """The image has more pixels than allowed."""


@dataclass(frozen=True)
class Photograph:
    """A decoded photograph ``(H, W, 3)``, BGR, and what may impair the result, ordered by name."""

    pixels: NDArray[np.uint8]
    warnings: tuple[ImageWarning, ...] = ()

    @classmethod
    def of(cls, pixels: NDArray[np.uint8], *found: ImageWarning) -> Photograph:
        """Make a photograph; if the picture ``(H, W, 3)`` is dark, add that to the warnings."""
        bright = np.percentile(_sample(pixels), _BRIGHT_PERCENTILE)
        dark: tuple[ImageWarning, ...] = ("dark",) if bright < _DARK_BELOW else ()
        return cls(pixels, (*dark, *sorted(found)))


def decode_image(data: bytes, *, max_pixels: int) -> Photograph:
    """Decode a photograph.

    The EXIF orientation is applied. Grey images get three equal channels, CMYK becomes BGR, an
    alpha channel is dropped, and an animation gives its first picture. 16 bits become 8; if the
    upper half of their range is not used, as with cameras of 10 to 14 bits, the used range is
    stretched. A JPEG is read if less than half of it is missing.

    Raises
    ------
    ImageTooLargeError
        If the header says that the image has more than ``max_pixels`` pixels.
    ImageError
        If the bytes are no image of :data:`FORMATS`, or a broken one.
    """
    header = _checked_header(data, max_pixels)
    with turn_of(header.width * header.height):
        return _photograph(data, header)


def _photograph(data: bytes, header: Image.Image) -> Photograph:
    pixels = _decode(data, header, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    found: list[ImageWarning] = []
    if (
        header.format in _JPEG
        and (missing := _missing_share(pixels))
        and _lacks_its_end(data, header)
    ):
        if missing > _MAX_MISSING_SHARE:
            raise ImageError("the JPEG image is broken: most of it is missing")
        found.append("truncated")
    if pixels.dtype == np.uint16:
        low, high = _used_range(pixels)
        if (low, high) != (0, 2**16):
            found.append("stretched")
        levels = (np.arange(2**16) - low) * 256 // (high - low)
        pixels = np.clip(levels, 0, 255).astype(np.uint8)[pixels]
    return Photograph.of(pixels, *found)


_LARGE_PX = 2_500_000  # More than a frame of 1080p.
_LARGE_ONES = Lock()


def turn_of(pixels: int) -> AbstractContextManager[object]:
    """Wait for the turn of a large image: while it is worked on, it takes several times its size.

    Small images do not wait.
    """
    return _LARGE_ONES if pixels > _LARGE_PX else nullcontext()


_ORIENTATION, _ON_THE_SIDE = 0x0112, (5, 6, 7, 8)  # EXIF tag, and values that swap the sides.


def blank_image(data: bytes, *, max_pixels: int) -> Photograph:
    """Make a black photograph of the size of an encoded one, for answers that need no more.

    Of a JPEG, only the header is read, so the rest may be missing or broken. Raises like
    :func:`decode_image`.
    """
    header = _checked_header(data, max_pixels)
    if header.format in _JPEG:
        on_the_side = header.getexif().get(_ORIENTATION) in _ON_THE_SIDE
        shape = header.size if on_the_side else header.size[::-1]
    else:
        shape = _decode(data, header, cv2.IMREAD_COLOR).shape[:2]
    return Photograph(np.zeros((*shape, 3), np.uint8))


Labels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


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
        The smallest part that holds all labels, since most of a mask is background.
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
        # `boundingRect` takes 8 bits only.
        marked = labels if labels.dtype == np.uint8 else np.asarray(labels != 0).view(np.uint8)
        left, top, width, height = cv2.boundingRect(marked)
        part = labels[top : top + height, left : left + width].copy()
        return cls(labels, _labels_in(part), left, top, part)

    @cached_property
    def boxes(self) -> list[Box]:
        """The tight box of each label."""
        found = []
        for label in self.present:
            left, top, width, height = cv2.boundingRect(cv2.inRange(self.part, label, label))
            found.append(Box(self.left + left - 0.5, self.top + top - 0.5, width, height))
        return found

    def merged(self) -> LabelImage:
        """The same image with all labels merged into one person, label 1."""
        labels, part = ((image != 0).view(np.uint8) for image in (self.labels, self.part))
        return LabelImage(labels, [1] if self.present else [], self.left, self.top, part)


def decode_mask(data: bytes, *, max_pixels: int) -> LabelImage:
    """Decode a label image: 0 is background, k is person k.

    Grey images and PNG images with a palette keep their stored values, whatever their bit depth: of
    a palette, the indices are used, not the colours. An image with only two values, 0 and one
    other, marks one person (label 1). So does a lossy image (JPEG, WebP), since compression
    destroys labels; there, values of 128 and above mark the person. Three channels are accepted if
    they are equal. The EXIF orientation is applied. The alpha channel is used only if all other
    channels are black; alpha values of 128 and above mark one person.

    Raises
    ------
    ImageTooLargeError, ImageError
        As for :func:`decode_image`, or if the image is coloured, a lossy image is
        not essentially black and white, or there are more than 100 labels or labels too scattered
        to mark people.
    """
    header = _checked_header(data, max_pixels)
    with turn_of(header.width * header.height):
        return _checked(_label_image(data, header))


def _label_image(data: bytes, header: Image.Image) -> LabelImage:
    if header.format == "PNG" and header.mode == "P":
        return LabelImage.of(_stored(data))
    pixels = _decode(data, header, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if _is_lossy(header, data):
        values = _one_channel(pixels, _LOSSY_CHANNEL_DIFFERENCE)
        return LabelImage.of(_thresholded(values))
    labels = _one_channel(pixels, 0)
    if header.format == "PNG" and header.mode == "L":
        # OpenCV stretches 2 and 4 bits to 0..255; the 25th byte of a PNG is its bit depth.
        labels = labels // {2: 85, 4: 17}.get(data[24], 1)
    if header.mode in ("RGBA", "LA") and not labels.any():
        alpha = _stored(data)[..., -1]
        if alpha.min() < _LOSSY_THRESHOLD:
            labels = np.asarray(alpha >= _LOSSY_THRESHOLD).view(np.uint8)
    return LabelImage.of(labels)


# A picture is dark if this percentile of its values is lower than the limit.
_BRIGHT_PERCENTILE = 99.0
_DARK_BELOW = 20.0

_MAX_MISSING_SHARE = 0.5  # A JPEG of which more is missing is refused.

# libjpeg's decoder fills the missing part of a JPEG with exactly this grey.
_MISSING = 128
_BLOCK_PX = 8


def _missing_share(pixels: NDArray[np.uint8]) -> float:
    """Share of a JPEG's pixels ``(H, W, 3)`` that its decoder did not find; 0 if the end is there.

    The corner in which a JPEG ends depends on the EXIF orientation, so all corners are checked.
    """
    ends = (slice(_BLOCK_PX), slice(-_BLOCK_PX, None))
    corners = (pixels[rows, columns] for rows in ends for columns in ends)
    if not any((corner == _MISSING).all() for corner in corners):
        return 0.0
    return float((pixels == _MISSING).all(axis=2).mean())


_TAIL_BYTES = 64


def _lacks_its_end(data: bytes, header: Image.Image) -> bool:
    """Whether the grey at the end of a JPEG is missing, and not stored.

    The last bytes of its scan belong to the grey itself if it is stored, to the pixels before it if
    not. So without these bytes, others change. A progressive JPEG has several scans; only its end
    marker shows it.
    """
    end = data.find(_END_OF_JPEG, data.rfind(_SCAN_OF_JPEG))
    if header.info.get("progressive"):
        return end < 0
    cut = data[: (end if end >= 0 else len(data)) - _TAIL_BYTES]
    before, after = (_decode(one, header, cv2.IMREAD_GRAYSCALE) for one in (data, cut))
    changed = before[before != after]
    return bool((changed != _MISSING).sum() > (changed == _MISSING).sum())


# The range of 16-bit values that is stretched excludes outliers of this percentage, and is at
# least this wide: a narrower one would be noise.
_OUTLIER_PERCENTILE = 0.1
_MIN_USED_RANGE = 64


def _used_range(pixels: NDArray[np.uint16]) -> tuple[int, int]:
    """The used range of 16 bits, its end excluded; all if it reaches the upper half or is tiny.

    Outliers are ignored.
    """
    outliers = _OUTLIER_PERCENTILE
    sample = _sample(pixels)
    low, high = np.percentile(sample, [outliers, 100 - outliers]).astype(int).tolist()
    if high >= 2**15 or high - low < _MIN_USED_RANGE:
        return 0, 2**16
    return low, high + 1


_SAMPLED_PX = 20_000  # Percentiles of the sample take half a millisecond.


def _sample(pixels: NDArray[Any]) -> NDArray[Any]:
    """Pixels evenly spaced in an image ``(H, W, ...)``, few enough for statistics."""
    height, width = pixels.shape[:2]
    step = math.ceil(math.sqrt(height * width / _SAMPLED_PX))
    return pixels[:: min(step, height), :: min(step, width)]


_MAX_LABELS = 100  # With more values, an image is a mask with soft edges, not a crowd.
# Most pairs of neighbouring pixels with different labels: this number and, above the last one,
# also this share of the pixels. Fifty people who fill a frame of 12 megapixels have 400,000, a
# thirtieth of the pixels; noise has two for each pixel.
_MAX_LABEL_CHANGES = 1_000_000
_MAX_LABEL_CHANGE_SHARE = 0.5
_FEW_LABEL_CHANGES = 10_000


def _checked(image: LabelImage) -> LabelImage:
    """Check that the labels of an image may mark people; a single label becomes label 1."""
    count, part = len(image.present), image.part
    if count > _MAX_LABELS:
        raise ImageError(
            f"expected a mask of at most {_MAX_LABELS} labels, got {count}: "
            "a mask with soft edges must be thresholded first"
        )
    changes = sum(
        np.count_nonzero(first != second)
        for first, second in ((part[:, 1:], part[:, :-1]), (part[1:], part[:-1]))
    )
    many = max(_FEW_LABEL_CHANGES, _MAX_LABEL_CHANGE_SHARE * part.size)
    most = min(_MAX_LABEL_CHANGES, round(many))
    if changes > most:
        raise ImageError(
            "expected a mask whose labels mark people, got scattered ones: "
            f"{changes} neighbouring pixels differ, more than {most}"
        )
    return image.merged() if count == 1 and image.present != [1] else image


def _labels_in(part: Labels) -> list[int]:
    """The labels in a contiguous part ``(h, w)``, ascending, without 0."""
    # calcHist is several times as fast as np.unique or np.bincount.
    if part.size == 0:
        return []
    bins = int(part.max()) + 1
    counts = cv2.calcHist([part], [0], None, [bins], [0, bins])
    return (np.flatnonzero(counts[1:]) + 1).tolist()


_LOSSY_THRESHOLD = 128  # Value from which a pixel of a lossy mask is the person's.
# Lossy compression moves black and white by up to this, except at edges; pixels in between may be
# this share of those of the person.
_LOSSY_CERTAINTY = 48
_MAX_LOSSY_BETWEEN = 0.5

_LOSSY_CHANNEL_DIFFERENCE = 16  # Channels of a lossy grey image differ by up to this.


def _is_lossy(image: Image.Image, data: bytes) -> bool:
    """Whether the compression of an image may alter pixel values."""
    match image.format:
        case "WEBP":
            return b"VP8L" not in data
        case "TIFF":
            return image.info.get("compression") in ("jpeg", "tiff_jpeg")
    return image.format in _JPEG


def _thresholded(values: Labels) -> NDArray[np.uint8]:
    """The person ``(H, W)`` in a lossy mask; raise an error if its values look like labels."""
    marked = np.asarray(values >= _LOSSY_THRESHOLD).view(np.uint8)
    between = np.count_nonzero((values > _LOSSY_CERTAINTY) & (values < 255 - _LOSSY_CERTAINTY))
    allowed = _MAX_LOSSY_BETWEEN * int(np.count_nonzero(marked))
    # Labels that are small numbers leave nothing above the threshold.
    if between > allowed or (values.any() and not marked.any()):
        raise ImageError(
            "expected a mask of black and white, since lossy compression (JPEG, WebP) keeps no "
            "labels, got one of other values; send labels as PNG"
        )
    return marked


def _one_channel(pixels: NDArray[Any], max_difference: int) -> Labels:
    """Values ``(H, W)`` of an image of one channel, or of three that differ by no more."""
    if pixels.ndim == 2:
        return pixels
    first, *others = (pixels[..., channel] for channel in range(pixels.shape[2]))
    if any(cv2.absdiff(first, other).max() > max_difference for other in others):
        raise ImageError("expected a mask of one channel or of equal ones, got a coloured one")
    return np.ascontiguousarray(first)


def _stored(data: bytes) -> NDArray[np.uint8]:
    """Stored values of an image: the indices ``(H, W)`` of a palette, or all channels."""
    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            return np.asarray(ImageOps.exif_transpose(image))
    except Exception as error:  # Damaged data make Pillow raise almost anything.
        raise ImageError("the image is broken") from error


def _checked_header(data: bytes, max_pixels: int) -> Image.Image:
    """Read a header; raise :class:`ImageError` if the image should not be decoded."""
    header = _read_header(data)
    if header.width * header.height > max_pixels:
        raise ImageTooLargeError(
            f"expected at most {max_pixels} pixels, got {header.width}x{header.height}"
        )
    if header.format == "TIFF" and header.mode in ("F", "I"):
        kind = "floating point" if header.mode == "F" else "whole numbers"
        raise ImageError(f"expected 8 or 16 bits a channel, got 32 bit {kind}")
    if header.format == "PNG":
        # OpenCV allocates what a chunk announces: two gigabytes for a file of a kilobyte.
        try:
            header.verify()
        except Exception as error:
            raise ImageError("the PNG image is broken") from error
    return header


def _read_header(data: bytes) -> Image.Image:
    """Read format and size, as stored, without decoding the image.

    Raises
    ------
    ImageError
        If the bytes are empty, of none of :data:`FORMATS`, or end within the header.
    """
    if not data:
        raise ImageError("expected an image, got no bytes")
    try:
        return Image.open(_LimitedReads(data), formats=FORMATS)
    except ImageError:
        raise
    except Exception as error:  # Damaged headers make Pillow raise almost anything.
        raise ImageError(
            f"expected a PNG, JPEG, WebP, BMP, TIFF or GIF image, got {_kind(data)}"
        ) from error


_SIGNATURES = {
    b"%PDF": "PDF",
    b"8BPS": "PSD",
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
}
_BRANDS = {
    **dict.fromkeys((b"avif", b"avis"), "AVIF"),
    **dict.fromkeys((b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1"), "HEIC"),
}


def _kind(data: bytes) -> str:
    """Name the kind of bytes that are no image of :data:`FORMATS`."""
    named = (name for start, name in _SIGNATURES.items() if data.startswith(start))
    if data[4:8] == b"ftyp":
        return _BRANDS.get(data[8:12], "a video")
    return next(named, "something else or a broken one")


# Reads that an image may take, and further bytes for each further read. Pillow keeps every segment
# of a JPEG: 16 MB of empty ones would take ten seconds and 700 MB.
_FREE_READS = 10_000
_BYTES_PER_READ = 500


class _LimitedReads(io.BytesIO):
    """Encoded bytes with a limited number of reads."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._reads_left = _FREE_READS + len(data) // _BYTES_PER_READ

    def read(self, size: int | None = -1, /) -> bytes:
        self._reads_left -= 1
        if self._reads_left < 0:
            raise ImageError("expected an image, got one of too many segments")
        return super().read(size)


_JPEG = ("JPEG", "MPO")
_SCAN_OF_JPEG = b"\xff\xda"
_END_OF_JPEG = b"\xff\xd9"


def _decode(data: bytes, header: Image.Image, flags: int) -> NDArray[Any]:
    """Decode to 8 or 16 bits a channel with OpenCV, which raises or returns None if it fails."""
    if header.format in _JPEG:
        # Some cameras leave out the end marker. A second one does no harm, since bytes after the
        # first are ignored.
        data += _END_OF_JPEG
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"the {header.format} image is broken") from error
    if pixels is None:
        raise ImageError(f"the {header.format} image is broken")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"expected 8 or 16 bits a channel, got {pixels.dtype} values")
    return pixels
