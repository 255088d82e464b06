"""Files: their kinds, and JPEG and PNG without all that decoding their pixels does not need.

Decoders do as they are told by a file. Texts behind a PNG's pixels make them unpack gigabytes, the
tags of an EXIF segment may all hold the same megabyte, and each further scan of a progressive JPEG
goes over all pixels again. What is left here takes time and memory in proportion to the pixels and
the bytes of the file.
"""

from __future__ import annotations

import re
import struct
import zlib
from typing import Literal

HEAD_BYTES = 512

_STARTS = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"BM": "a BMP image",
    b"II*\0": "a TIFF image",
    b"MM\0*": "a TIFF image",
    b"GIF8": "a GIF image",
    b"8BPS": "PSD",
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
    b"%PDF": "PDF",
    b"PK\x03\x04": "a ZIP archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"\x1f\x8b": "a gzip archive",
    b"BZh": "a bzip2 archive",
    b"\xfd7zXZ": "an xz archive",
    b"\x28\xb5\x2f\xfd": "a Zstandard archive",
    b"#EXTM3U": "a playlist (M3U)",
    b"ffconcat": "a playlist (ffconcat)",
    b"[playlist]": "a playlist (PLS)",
    b"ID3": "sound (MP3)",
    b"fLaC": "sound (FLAC)",
    b".RMF": "RealMedia",
    b"YUV4MPEG2": "YUV4MPEG",
    b"\x06\x0e\x2b\x34": "MXF",
    b"<": "a page or XML",
    b"{": "JSON",
}
_BRANDS = {
    **dict.fromkeys((b"avif", b"avis"), "AVIF"),
    **dict.fromkeys((b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1"), "HEIC"),
}
_RIFF = {b"WEBP": "a WebP image", b"WAVE": "sound (WAV)"}
_DASH, _ANIMATION, _TAR = b"<MPD", b"ANIM", b"ustar"


def kind_of(data: bytes) -> str:
    r"""Name the kind of a file, given at least its first :data:`HEAD_BYTES`.

    Examples
    --------
    >>> kind_of(b"#EXTM3U\n#EXTINF:2,\none.ts")
    'a playlist (M3U)'
    """
    head = data[:HEAD_BYTES].removeprefix(b"\xef\xbb\xbf").lstrip(b"\r\n\t ")
    if head[4:8] == b"ftyp":
        return _BRANDS.get(head[8:12], "a video")
    if head.startswith(b"RIFF") and head[8:12] in _RIFF:
        animated = head[8:12] == b"WEBP" and _ANIMATION in head
        return "an animated WebP image" if animated else _RIFF[head[8:12]]
    if _DASH in head:
        return "a playlist (DASH)"
    if head[257:262] == _TAR:
        return "a tar archive"
    named = (name for start, name in _STARTS.items() if head.startswith(start))
    return next(named, "something else or a broken one")


_JPEG_START, _PNG_START = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"

# Segments or chunks in a file. A JPEG has one for each 64 KiB of data about it, a PNG often one for
# each 8 KiB or each row.
_MAX_SEGMENTS = 10_000

# Encoders write up to 18 scans (libjpeg, CMYK); colours take 10, with mozjpeg up to 16. A scan that
# changes nothing takes up to 25 ms in 12 megapixels.
_MAX_SCANS = 32


class NotPlainError(ValueError):
    """The file is broken, or more expensive than any encoder makes it; says what was found."""


def plain(data: bytes) -> bytes:
    """Copy a JPEG or PNG without texts, profiles, previews and, except for its orientation, EXIF.

    Other files are returned as they are.

    Raises
    ------
    NotPlainError
        If it ends before its pixels, or has too many segments, chunks or scans.
    """
    if data.startswith(_PNG_START):
        return _plain_png(data)
    return _plain_jpeg(data) if data.startswith(_JPEG_START) else data


# The second byte of the markers of a JPEG.
_WITHOUT_LENGTH = {0x01, *range(0xD0, 0xD9)}
_END, _SCAN, _EXIF = 0xD9, 0xDA, 0xE1
_PROGRESSIVE = {0xC2, 0xC6, 0xCA, 0xCE}
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
# Tables, restarts, and the two segments that say how colours are stored.
_NEEDED = {*range(0xC0, 0xD0), 0xDB, 0xDD, 0xE0, 0xEE} - {0xC8}
_MARKER = re.compile(rb"\xff[^\x00\xff]")
_EXIF_START = b"Exif\0\0"


def _plain_jpeg(data: bytes) -> bytes:
    whole, at, orientation, frame = memoryview(data), 2, b"", b""
    kept = [whole[:2]]
    for _ in range(_MAX_SEGMENTS):
        marker = _MARKER.search(data, at)
        if marker is None or (kind := data[marker.start() + 1]) == _END:
            raise NotPlainError("a broken one")
        if kind in _WITHOUT_LENGTH:
            at = marker.end()
            continue
        begin, body = marker.start(), marker.end()
        at = body + max(2, int.from_bytes(data[body : body + 2]))
        if kind == _SCAN:
            _check_scans(data, begin, frame)
            is_plain = sum(map(len, kept)) == begin and not orientation
            return data if is_plain else b"".join((*kept, whole[begin:]))
        if kind in _FRAMES and not frame:
            frame = data[begin:at]
        if kind in _NEEDED:
            kept.append(whole[begin:at])
        elif kind == _EXIF and not orientation and data.startswith(_EXIF_START, body + 2):
            orientation = _orientation_alone(data[body + 2 + len(_EXIF_START) : at])
            exif = _EXIF_START + orientation
            kept.append(memoryview(struct.pack(">BBH", 0xFF, _EXIF, 2 + len(exif)) + exif))
    raise NotPlainError("one of too many segments")


def _check_scans(data: bytes, begin: int, frame: bytes) -> None:
    """Check the scans of a JPEG whose first one begins there."""
    if len(frame) < 10 or len(data) < begin + 5:
        raise NotPlainError("a broken one")
    if frame[1] not in _PROGRESSIVE and data[begin + 4] >= frame[9]:
        return  # All components are in this scan, and decoders read no further one.
    # Decoders differ in what they take for a marker in broken data, so that all are counted.
    scans = data.count(bytes((0xFF, _SCAN)), begin)
    if scans > _MAX_SCANS:
        raise NotPlainError(f"a JPEG of {scans} scans, more than {_MAX_SCANS}")


_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT")


def _plain_png(data: bytes) -> bytes:
    whole, kept, at, orientation = memoryview(data), [memoryview(data)[:8]], 8, b""
    for _ in range(_MAX_SEGMENTS):
        if len(data) < at + 12:
            break
        size, kind = struct.unpack_from(">I4s", data, at)
        chunk, at = whole[at : at + 12 + size], at + 12 + size
        if kind in _PIXELS or kind == b"IEND":
            # OpenCV would allocate what a chunk announces: gigabytes for a file of a kilobyte.
            if len(data) < at or zlib.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:]):
                break
            kept.append(chunk)
        elif kind == b"eXIf" and not orientation:
            orientation = _orientation_alone(bytes(chunk[8:-4]))
        if kind == b"IEND":
            if orientation:  # Behind the header, since OpenCV does not see it behind the pixels.
                kept.insert(2, memoryview(_png_chunk(b"eXIf", orientation)))
            return data if sum(map(len, kept)) == len(data) and not orientation else b"".join(kept)
    else:
        raise NotPlainError("one of too many segments")
    raise NotPlainError("a broken one")


def _png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


_ORIENTATION = 0x0112


def _orientation_alone(exif: bytes) -> bytes:
    """EXIF data of the same orientation and nothing else."""
    order: Literal["little", "big"] = "big" if exif.startswith(b"MM") else "little"
    directory = int.from_bytes(exif[4:8], order) + 2
    count = int.from_bytes(exif[directory - 2 : directory], order)
    upright = 1
    for entry in range(directory, min(directory + 12 * count, len(exif) - 11), 12):
        if int.from_bytes(exif[entry : entry + 2], order) == _ORIENTATION:
            upright = int.from_bytes(exif[entry + 8 : entry + 10], order)
            break
    return b"II*\0\x08\0\0\0\x01\0" + struct.pack("<HHIHHI", _ORIENTATION, 3, 1, upright, 0, 0)
