"""Valid images that are small and would cost much more than their bytes and pixels."""

import io
import struct
import zlib
from collections.abc import Iterable

from PIL import Image

LARGE = 3528, 3536
"""Rows and columns of almost as many pixels as the service takes by default."""


def jpeg(scans: int, shape: tuple[int, int] = LARGE, *, progressive: bool = True) -> bytes:
    """A grey JPEG; its scans beyond the first two change nothing."""
    rows, columns = shape
    blocks = -(-rows // 8) * -(-columns // 8)

    def segment(marker: int, body: bytes) -> bytes:
        return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body

    def code(table: int, symbol: int) -> bytes:  # One code of one bit: 0.
        return segment(0xC4, bytes([table, 1, *[0] * 15, symbol]))

    def scan(first: int, last: int, bits: int, data: int) -> bytes:
        return segment(0xDA, bytes([1, 1, 0, first, last, bits])) + bytes(data)

    frame = struct.pack(">BHHB3B", 8, rows, columns, 1, 1, 0x11, 0)
    head = b"\xff\xd8" + segment(0xDB, bytes([0, *[1] * 64]))
    if not progressive:
        one = scan(0, 63, 0, 8)
        return (
            head + segment(0xC0, frame.replace(b"\1\1\x11\0", b"\3\1\x11\0\2\x11\0\3\x11\0"))
            + code(0, 0) + code(0x10, 0) + one * scans + b"\xff\xd9"
        )  # fmt: skip
    runs = -(-(-(-blocks // 16384) * 15) // 8)  # Ends of up to 32767 blocks in 15 bits each.
    return (
        head + segment(0xC2, frame) + code(0, 0) + code(0x10, 0xE0)
        + scan(0, 0, 0, -(-blocks // 8)) + scan(1, 63, 1, runs)
        + scan(1, 63, 0x10, runs) * scans + b"\xff\xd9"
    )  # fmt: skip


def with_exif(jpeg_: bytes) -> bytes:
    """Put EXIF before a JPEG's tables; each of its 2,700 tags holds the same 60 KB."""
    body = b"Exif\0\0" + tags_of_everything(2700, 60_000)
    return jpeg_[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg_[2:]


def tags_of_everything(count: int, size: int, first: bytes = b"", entries: int = 0) -> bytes:
    """A TIFF of tags that all hold the same bytes, behind some other ``entries``."""
    tags = (struct.pack("<HHII", 0x9000 + n, 7, size, 0) for n in range(count))
    directory = struct.pack("<H", entries + count) + first + b"".join(tags) + bytes(4)
    return (b"II*\0\x08\0\0\0" + directory).ljust(size, b"\0")


def png(texts: int, *, behind: bool = True) -> bytes:
    """A PNG of 64x64 with texts of 8 MB, each in 8 KB."""
    # Before the pixels, Pillow takes up to 1 MB.
    packed = zlib.compress(b"A" * (7_999_000 if behind else 900_000), 9)
    pixels = _chunk(b"IDAT", zlib.compress((b"\0" + bytes(3 * 64)) * 64))
    notes = b"".join(_chunk(b"zTXt", b"k%d\0\0" % number + packed) for number in range(texts))
    return _png(64, 64, 8, 2, 0, pixels + notes if behind else notes + pixels)


def interlaced_png() -> bytes:
    """A transparent PNG of 16 bits a channel."""
    rows, columns = LARGE
    packer, parts = zlib.compressobj(9), []
    passes = ("0088", "0488", "4084", "0244", "2042", "0122", "1021")
    for top, left, down, right in (map(int, one) for one in passes):
        row = b"\0" + bytes(8 * -(-(columns - left) // right))
        parts += [packer.compress(row) for _ in range(-(-(rows - top) // down))]
    pixels = _chunk(b"IDAT", b"".join([*parts, packer.flush()]))
    return _png(columns, rows, 16, 6, 1, pixels)


def _png(width: int, height: int, bits: int, colour: int, interlaced: int, chunks: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + chunks + _chunk(b"IEND", b"")


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _entries(tags: dict[int, tuple[int, ...] | int]) -> tuple[bytes, bytes]:
    """Entries of a TIFF's directory, and the values that do not fit, which begin its data."""
    entries, more = b"", b""
    for tag, values in sorted(tags.items()):
        numbers = (values,) if isinstance(values, int) else values
        packed = struct.pack(f"<{len(numbers)}I", *numbers)
        if len(numbers) > 1:
            packed, more = struct.pack("<I", 8 + len(more)), more + packed
        entries += struct.pack("<HHI", tag, 4, len(numbers)) + packed
    return entries, more


def _tiff(tags: dict[int, tuple[int, ...] | int], data: bytes, following: int = 0) -> bytes:
    """A TIFF whose directory comes last; ``data`` must begin with the values of its tags."""
    entries, _ = _entries(tags)
    directory = struct.pack("<H", len(entries) // 12) + entries + struct.pack("<I", following)
    return b"II*\0" + struct.pack("<I", 8 + len(data)) + data + directory


# Width, height, bits, no compression or Deflate (8), RGB, samples.
_RGB: dict[int, tuple[int, ...] | int] = {258: (8, 8, 8), 259: 8, 262: 2, 277: 3}


def tiff_tile(side: int) -> bytes:
    """A TIFF of 64x64 in one tile."""
    packer = zlib.compressobj(9)
    tile = b"".join(packer.compress(bytes(3 * side)) for _ in range(side)) + packer.flush()
    tags = _RGB | {256: 64, 257: 64, 322: side, 323: side, 324: 20, 325: len(tile)}
    return _tiff(tags, _entries(tags)[1] + tile)


def tiff_strips() -> bytes:
    """A TIFF of one strip for each row; each holds the same 2 MB, of which one row is needed."""
    rows, columns = LARGE
    stored = zlib.compress(bytes(3 * columns)) + bytes(2_000_000)
    tags = _RGB | {256: columns, 257: rows, 278: 1, 279: (len(stored),) * rows}
    tags[273] = (0,) * rows
    begin = 8 + len(_entries(tags)[1])
    tags[273] = (begin,) * rows
    return _tiff(tags, _entries(tags)[1] + stored)


def tiff_tags() -> bytes:
    """A TIFF of 64x64 with 5,000 tags of 1 MB each."""
    tags = _RGB | {256: 64, 257: 64, 259: 1, 273: 0, 278: 64, 279: 3 * 64 * 64, 258: 8}
    entries, _ = _entries(tags)
    return tags_of_everything(5000, 1_000_000, entries, len(tags))


def tiff_circle() -> bytes:
    """A TIFF of 64x64 whose directory is followed by itself."""
    tags = _RGB | {256: 64, 257: 64, 259: 1, 273: 20, 278: 64, 279: 3 * 64 * 64}
    data = _entries(tags)[1] + bytes(3 * 64 * 64)
    return _tiff(tags, data, following=8 + len(data))


def gif(pictures: int, shape: tuple[int, int] | None = None) -> bytes:
    """A GIF of 1000x1000 with pictures of another shape, all the same."""
    rows, columns = shape or (1000, 1000)
    buffer = io.BytesIO()
    Image.new("P", (1000, 1000)).save(buffer, "GIF")
    whole = buffer.getvalue()
    begin = whole.index(b",", 13 + 3 * 2 ** ((whole[10] & 7) + 1) * (whole[10] >> 7))
    picture = b"," + struct.pack("<4xHH", columns, rows) + whole[begin + 9 : -1]
    return whole[:begin] + picture * pictures + b";"


def _riff(chunks: Iterable[bytes]) -> bytes:
    body = b"WEBP" + b"".join(chunks)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def webp_animation(pictures: int) -> bytes:
    """A WebP of as many pictures of 3528x3536."""
    buffer = io.BytesIO()
    Image.new("RGB", LARGE[::-1]).save(buffer, "WEBP", lossless=True, method=0)
    picture = buffer.getvalue()[12:]
    size = struct.pack("<I", LARGE[1] - 1)[:3] + struct.pack("<I", LARGE[0] - 1)[:3]
    canvas = b"VP8X" + struct.pack("<IB3x", 10, 2) + size
    loop = b"ANIM" + struct.pack("<I4xH", 6, 0)
    frame = bytes(6) + size + b"\x28\0\0\0" + picture
    return _riff([canvas, loop, *[b"ANMF" + struct.pack("<I", len(frame)) + frame] * pictures])


def bmp() -> bytes:
    """A BMP of runs of 255 pixels."""
    rows, columns = LARGE
    runs = (b"\xff\0" * (columns // 255) + bytes([columns % 255, 0]) + b"\0\0") * rows + b"\0\1"
    colours = bytes(4 * 256)
    begin = 14 + 40 + len(colours)
    head = struct.pack("<2sIHHI", b"BM", begin + len(runs), 0, 0, begin)
    shape = struct.pack("<IiiHHIIiiII", 40, columns, rows, 1, 8, 1, len(runs), 0, 0, 256, 0)
    return head + shape + colours + runs
