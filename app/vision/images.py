"""Encoded images become pixels.

A PNG of 389 KB can hold 20,000 x 20,000 pixels, which take seconds and gigabytes to decode, so
format and size are read from the header first. With that, time and memory are bounded for JPEG and
PNG (:mod:`app.vision.files`). A few hundred kilobytes of the other formats can take both without
bound; the service decodes them in :mod:`app.decoding`.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps, TiffImagePlugin

from app.vision.files import NotPlainError, kind_of, plain
from app.vision.halved import HalvedFrame

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")

ImageWarning = Literal[
    "crowded", "dark", "obstructed", "stretched", "truncated", "damaged", "zone_outside"
]
"""``crowded``: more people are seen than returned; ``dark``: the picture is too dark to show much;
``obstructed``: little is left of a camera's usual view;
``stretched``: a 16-bit image used only part of its range, which was stretched; ``truncated``: the
end of the image is missing; ``damaged``: a frame of a video whose data is incomplete or wrong;
``zone_outside``: a zone of the camera lies outside the frame."""


def configure_pillow() -> None:
    """Lift Pillow's own limit of pixels, since callers check theirs, and silence its warnings.

    Pillow warns about every unusual tag. Both settings apply to the whole process.
    """
    Image.MAX_IMAGE_PIXELS = None
    warnings.filterwarnings("ignore", module="PIL")


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
        sample = _sample(pixels)
        # Counting takes a seventh of the time of a percentile.
        is_dark = np.count_nonzero(sample >= 20) <= 0.01 * sample.size
        dark: tuple[ImageWarning, ...] = ("dark",) if is_dark else ()
        return cls(pixels, (*dark, *sorted(found)))


def decode_image(
    data: bytes, *, max_pixels: int, checkpoint: Callable[[], None] = lambda: None
) -> Photograph:
    """Decode a photograph.

    The EXIF orientation is applied. Grey images get three equal channels, CMYK becomes BGR, and an
    animation gives its first picture. Transparent pixels are blended with grey, so their hidden
    colours do not count. 16 bits become 8; if the upper half of their range is not used, as with
    cameras of 10 to 14 bits, the used range is stretched. A JPEG or TIFF is read if less than half
    of it is missing. A large image may have to wait for another one; meanwhile, ``checkpoint`` is
    called, which raises an error if the result is not wanted.

    Raises
    ------
    ImageTooLargeError
        If the header says that the image has more than ``max_pixels`` pixels.
    ImageError
        If the bytes are not an image of :data:`FORMATS`, or a broken one.
    """
    data, header = read_header(data, max_pixels)
    with turn_of(header.width * header.height, checkpoint):
        return _photograph(data, header)


_EXPENSIVE = (b"RIFF", b"II", b"MM", b"GIF8", b"BM")


def is_expensive(data: bytes) -> bool:
    """Whether a file may take more time or memory than its bytes and pixels suggest.

    These are WebP, TIFF, GIF and BMP. A WebP may have 65,536 codes for its colours, each with 5 KB
    of tables, and each strip of a TIFF may be all of the file.
    """
    return data.startswith(_EXPENSIVE)


def _photograph(data: bytes, header: Image.Image) -> Photograph:
    missing, lost_bytes = _lost_strips(data, header)
    _check_missing(missing, header)
    # A decoder gives up where strips are not stored.
    data += bytes(min(lost_bytes, round(missing * _BYTES_PER_PIXEL * math.prod(header.size))))
    if header.has_transparency_data:
        pixels: NDArray[Any] = _upon_grey(read_stored(data, "RGBA"))
    else:
        pixels = decode_pixels(data, header, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if (
        header.format == "JPEG"
        and (grey := _missing_share(pixels))
        and _lacks_its_end(data, header)
    ):
        missing = grey
        _check_missing(missing, header)
    found: list[ImageWarning] = ["truncated"] if missing else []
    if pixels.dtype == np.uint16:
        low, high = _used_range(pixels)
        if (low, high) != (0, 2**16):
            found.append("stretched")
        levels = (np.arange(2**16) - low) * 256 // (high - low)
        pixels = np.clip(levels, 0, 255).astype(np.uint8)[pixels]
    return Photograph.of(pixels, *found)


_BYTES_PER_PIXEL = 8  # At most, in a TIFF.


def _check_missing(share: float, header: Image.Image) -> None:
    # An image with a larger missing share is refused.
    if share > 0.5:
        raise ImageError(f"the {header.format} image is broken: most of it is missing")


def _upon_grey(rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """BGR pixels of RGBA ones, with transparent pixels blended with grey."""
    alpha = cv2.cvtColor(rgba[..., 3], cv2.COLOR_GRAY2BGR)
    shown = cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR)
    cv2.multiply(shown, alpha, dst=shown, scale=1 / 255)
    cv2.bitwise_not(alpha, dst=alpha)
    return np.asarray(cv2.addWeighted(shown, 1.0, alpha, 128 / 255, 0.0, dst=shown), np.uint8)


# Shares of a JPEG's sides at which its coefficients give a grey picture.
_REDUCED = {
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
}


def reduced_grey(
    data: bytes, shape: tuple[int, ...], least: tuple[int, int]
) -> NDArray[np.uint8] | None:
    """A grey picture of an image ``(H, W)``, an eighth, a quarter or a half of its size.

    As :func:`_reduced`; None also if the picture would be smaller than ``least``.
    """
    height, width = shape[:2]
    by = next((by for by in _REDUCED if height // by >= least[0] and width // by >= least[1]), None)
    return None if by is None else _reduced(data, shape, _REDUCED[by])


def halved(
    data: bytes, shape: tuple[int, ...], checkpoint: Callable[[], None] = lambda: None
) -> tuple[HalvedFrame, tuple[ImageWarning, ...]] | None:
    """Decode a photograph at half its size, with the warnings of :class:`Photograph`.

    None if :func:`decode_image` has to look at it: it is not a whole, upright JPEG of this shape.
    """
    pixels = math.prod(shape[:2])
    with turn_of(pixels, checkpoint):
        half = _reduced(data, shape, cv2.IMREAD_REDUCED_COLOR_2)
    if half is None or _missing_share(half, _BLOCK_PX // 2):
        return None
    whole = HalvedFrame(shape, half, lambda: decode_image(data, max_pixels=pixels).pixels)
    return whole, Photograph.of(half).warnings


def _reduced(data: bytes, shape: tuple[int, ...], flags: int) -> NDArray[np.uint8] | None:
    """A smaller picture of a JPEG, by OpenCV's flags.

    It is read from the coefficients, in less than half the time of decoding the pixels. None if the
    file is not a whole, upright JPEG of this shape.
    """
    if _END_OF_JPEG not in data[-_TAIL_BYTES:]:
        return None
    height, width = shape[:2]
    try:
        data, header = read_header(data, height * width)
    except ImageError:
        return None
    upright = header.getexif().get(ExifTags.Base.Orientation, 1) == 1
    if header.format != "JPEG" or header.size != (width, height) or not upright:
        return None
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    return None if picture is None else np.asarray(picture, np.uint8)


_LARGE_ONES = Lock()
_CHECKED_EVERY_S = 0.05


@contextmanager
def turn_of(pixels: int, checkpoint: Callable[[], None]) -> Iterator[None]:
    """Wait for the turn of a large image: processing it takes several times its memory.

    Small images do not wait. While a large one waits, ``checkpoint`` is called; it may raise.
    """
    # More than a frame of 1080p.
    if pixels <= 2_500_000:
        yield
        return
    while not _LARGE_ONES.acquire(timeout=_CHECKED_EVERY_S):
        checkpoint()
    try:
        yield
    finally:
        _LARGE_ONES.release()


def blank_image(
    data: bytes, *, max_pixels: int, checkpoint: Callable[[], None] = lambda: None
) -> Photograph:
    """Make a black photograph of the size of an encoded one, for answers that need no more.

    Of a JPEG, only the header is read: the rest may be missing. Raises like :func:`decode_image`.
    """
    data, header = read_header(data, max_pixels)
    if header.format == "JPEG":
        on_the_side = header.getexif().get(ExifTags.Base.Orientation) in (5, 6, 7, 8)
        shape = header.size if on_the_side else header.size[::-1]
    else:
        with turn_of(header.width * header.height, checkpoint):
            shape = decode_pixels(data, header, cv2.IMREAD_COLOR).shape[:2]
    return Photograph(np.zeros((*shape, 3), np.uint8))


# libjpeg's decoder fills the missing part of a JPEG with exactly this grey.
_MISSING = 128
_BLOCK_PX = 8


def _missing_share(pixels: NDArray[np.uint8], block_px: int = _BLOCK_PX) -> float:
    """Share of a JPEG's pixels ``(H, W, 3)`` that its decoder did not find; 0 if the end is there.

    The corner in which a JPEG ends depends on the EXIF orientation, so all corners are checked.
    """
    ends = (slice(block_px), slice(-block_px, None))
    corners = (pixels[rows, columns] for rows in ends for columns in ends)
    if not any((corner == _MISSING).all() for corner in corners):
        return 0.0
    return float((pixels == _MISSING).all(axis=2).mean())


_TAIL_BYTES = 64


def _lacks_its_end(data: bytes, header: Image.Image) -> bool:
    """Whether the grey at the end of a JPEG is missing, and not stored.

    If the grey is stored, the last bytes of the scan belong to the grey itself; if not, they belong
    to the pixels before it, so that other pixels change without these bytes. A progressive JPEG has
    several scans; only its end marker shows whether it is complete.
    """
    end = data.find(_END_OF_JPEG, data.rfind(_SCAN_OF_JPEG))
    if header.info.get("progressive"):
        return end < 0
    cut = data[: (end if end >= 0 else len(data)) - _TAIL_BYTES]
    before, after = (decode_pixels(one, header, cv2.IMREAD_GRAYSCALE) for one in (data, cut))
    changed = before[before != after]
    return bool((changed != _MISSING).sum() > (changed == _MISSING).sum())


def _used_range(pixels: NDArray[np.uint16]) -> tuple[int, int]:
    """The used range of 16 bits without outliers, end excluded; all if it is tiny or high."""
    low, high = np.percentile(_sample(pixels), [0.1, 99.9]).astype(int).tolist()
    if high >= 2**15 or high - low < 64:  # A narrower one would be noise.
        return 0, 2**16
    return low, high + 1


def _sample(pixels: NDArray[Any]) -> NDArray[Any]:
    """Pixels evenly spaced in an image ``(H, W, ...)``, few enough for statistics."""
    height, width = pixels.shape[:2]
    # Percentiles of 20,000 values take half a millisecond.
    step = math.ceil(math.sqrt(height * width / 20_000))
    return pixels[:: min(step, height), :: min(step, width)]


# Where strips or tiles of a TIFF begin, and their sizes.
_STRIPS = TiffImagePlugin.STRIPOFFSETS, TiffImagePlugin.STRIPBYTECOUNTS
_TILES = TiffImagePlugin.TILEOFFSETS, TiffImagePlugin.TILEBYTECOUNTS


def _lost_strips(data: bytes, header: Image.Image) -> tuple[float, int]:
    """Share of a TIFF's strips or tiles that are not in the file, and the bytes that it lacks."""
    tags: Any = getattr(header, "tag_v2", {})
    for begins, sizes in (_STRIPS, _TILES):
        places = [tags.get(begins), tags.get(sizes)]
        if all(isinstance(one, tuple) and {*map(type, one)} == {int} for one in places):
            strips = np.array([*zip(*places, strict=False)], np.float64)
            ends = strips.sum(axis=1)
            lost = (strips <= 0).any(axis=1) | (ends > len(data))
            return float(lost.mean()), max(0, int(ends.max()) - len(data))
    return 0.0, 0


def read_stored(data: bytes, mode: str | None = None) -> NDArray[np.uint8]:
    """Stored values of an upright image, for a palette its indices; in another mode of Pillow's."""
    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            ImageOps.exif_transpose(image, in_place=True)
            return np.asarray(image if mode in (None, image.mode) else image.convert(mode))
    except Exception as error:  # Damaged data make Pillow raise almost anything.
        raise ImageError("the image is broken") from error


def read_header(data: bytes, max_pixels: int) -> tuple[bytes, Image.Image]:
    """Read format and size, as stored, without decoding the image.

    Of a JPEG or PNG, the first value is what decoding needs.

    Raises
    ------
    ImageTooLargeError, ImageError
        As for :func:`decode_image`.
    """
    if not data:
        raise ImageError("expected an image, got no bytes")
    _check_size(_webp_size(data), max_pixels)  # Pillow allocates the pixels of a WebP at once.
    try:
        data = plain(data)
        header = Image.open(io.BytesIO(data), formats=FORMATS)
    except NotPlainError as error:
        raise ImageError(f"expected {_EXPECTED}, got {error}") from error
    except Image.DecompressionBombError as error:
        raise ImageTooLargeError(
            f"expected at most {max_pixels} pixels, got more than Pillow reads"
        ) from error
    except Exception as error:  # Damaged headers make Pillow raise almost anything.
        kind = kind_of(data)
        found = "a broken one" if kind.endswith("image") else kind
        raise ImageError(f"expected {_EXPECTED}, got {found}") from error
    _check_size(header.size, max_pixels)
    if header.format == "TIFF" and header.mode in ("F", "I"):
        kind = "floating point" if header.mode == "F" else "whole numbers"
        raise ImageError(f"expected 8 or 16 bits a channel, got 32 bit {kind}")
    return data, header


def read_size(data: bytes, max_pixels: int) -> tuple[int, int]:
    """Read width and height, in the memory of a header; raises like :func:`read_header`."""
    size = _webp_size(data)
    _check_size(size, max_pixels)
    return size if all(size) else read_header(data, max_pixels)[1].size


def _check_size(size: tuple[int, int], max_pixels: int) -> None:
    width, height = size
    if width * height > max_pixels:
        raise ImageTooLargeError(f"expected at most {max_pixels} pixels, got {width}x{height}")


def _webp_size(data: bytes) -> tuple[int, int]:
    """Width and height of a WebP; 0 for other files."""
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        match data[12:16]:
            case b"VP8X":
                width, height = (int.from_bytes(data[at : at + 3], "little") for at in (24, 27))
                return width + 1, height + 1
            case b"VP8L":
                bits = int.from_bytes(data[21:25], "little")
                return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
            case b"VP8 ":
                width, height = (int.from_bytes(data[at : at + 2], "little") for at in (26, 28))
                return width & 0x3FFF, height & 0x3FFF
    return 0, 0


_EXPECTED = "a PNG, JPEG, WebP, BMP, TIFF or GIF image"
_SCAN_OF_JPEG = b"\xff\xda"
_END_OF_JPEG = b"\xff\xd9"


def decode_pixels(data: bytes, header: Image.Image, flags: int) -> NDArray[Any]:
    """Decode to 8 or 16 bits a channel with OpenCV, or with Pillow for TIFFs OpenCV cannot read."""
    if header.format == "JPEG":
        # Some cameras leave out the end marker. A second one does no harm, since bytes after the
        # first are ignored.
        data += _END_OF_JPEG
    try:
        if _is_unusual(header):
            return _read_with_pillow(data, header, flags)
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"the {header.format} image is broken") from error
    if pixels is None:
        raise ImageError(f"the {header.format} image is broken")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"expected 8 or 16 bits a channel, got {pixels.dtype} values")
    return pixels


def is_lossy(image: Image.Image, data: bytes) -> bool:
    """Whether the compression of an image may alter pixel values."""
    match image.format:
        case "WEBP":
            return b"VP8L" not in data
        case "TIFF":
            return image.info.get("compression") in ("jpeg", "tiff_jpeg")
    return image.format == "JPEG"


def bits_of(header: Image.Image, data: bytes) -> int:
    """Bits that a grey PNG or TIFF stores for a channel."""
    if header.format == "PNG":
        return data[24]
    bits = getattr(header, "tag_v2", {}).get(TiffImagePlugin.BITSPERSAMPLE, (8,))
    return bits[0] if isinstance(bits, tuple) else 8


def _is_unusual(header: Image.Image) -> bool:
    """Whether OpenCV cannot decode this kind of TIFF."""
    if header.format != "TIFF":
        return False
    bits = bits_of(header, b"")
    packed = header.info.get("compression") in ("lzma", "zstd", "webp")
    return packed or bits in (2, 4) or (header.mode == "CMYK" and bits == 16)


def _read_with_pillow(data: bytes, header: Image.Image, flags: int) -> NDArray[np.uint8]:
    if header.mode in ("1", "L") and not flags & cv2.IMREAD_COLOR:
        return read_stored(data, "L")
    return np.asarray(cv2.cvtColor(read_stored(data, "RGB"), cv2.COLOR_RGB2BGR), np.uint8)
