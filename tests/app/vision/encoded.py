"""Encoded images for tests, some of which no encoder writes."""

import struct
import zlib

import cv2
import numpy as np


def encode(image: np.ndarray, extension: str = ".png", *parameters: int) -> bytes:
    return cv2.imencode(extension, image, list(parameters))[1].tobytes()


def png(rows: list[bytes], width: int, depth: int, colour: int, *chunks: tuple[bytes, bytes]):
    """A PNG that cv2.imencode cannot write."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", width, len(rows), depth, colour, 0, 0, 0)
    data = zlib.compress(b"".join(b"\0" + row for row in rows))
    middle = b"".join(chunk(*one) for one in chunks)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + middle + chunk(b"IDAT", data)
        + chunk(b"IEND", b"")
    )  # fmt: skip


def tiff(
    data: bytes, width: int, height: int, *, bits: int = 8, samples: int = 1, rows: int = 0
) -> bytes:
    """A TIFF of grey, RGB or CMYK in strips, which come last and may be missing."""
    rows = rows or height
    size, strips = rows * width * samples * bits // 8, -(-height // rows)
    photometric = {1: 1, 3: 2, 4: 5}[samples]
    tags: dict[int, list[int]] = {
        256: [width], 257: [height], 258: [bits] * samples, 259: [1], 262: [photometric],
        273: [], 277: [samples], 278: [rows], 279: [size] * strips,
    }  # fmt: skip
    begin = 8 + 2 + 12 * len(tags) + 4 + 4 * (2 * strips + samples)
    tags[273] = [begin + size * strip for strip in range(strips)]
    entries, more = b"", b""
    for tag, values in tags.items():
        packed = struct.pack(f"<{len(values)}I", *values)
        if len(values) > 1:
            more, packed = (
                more + packed,
                struct.pack("<I", begin - 4 * (2 * strips + samples) + len(more)),
            )
        entries += struct.pack("<HHI", tag, 4, len(values)) + packed
    head = b"II*\0\x08\0\0\0" + struct.pack("<H", len(tags)) + entries + bytes(4)
    return (head + more).ljust(begin, b"\0") + data


def with_orientation(jpeg: bytes, orientation: int) -> bytes:
    tiff = b"II*\0\x08\0\0\0\x01\0" + struct.pack("<HHIHHI", 0x112, 3, 1, orientation, 0, 0)
    body = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


def quadrants() -> np.ndarray:
    """40x60: blue, green / red, white, so that every orientation looks different."""
    image = np.zeros((40, 60, 3), np.uint8)
    image[:20, :30] = (255, 0, 0)
    image[:20, 30:] = (0, 255, 0)
    image[20:, :30] = (0, 0, 255)
    image[20:, 30:] = 255
    return image


# Stored pixels to upright pixels, as the EXIF standard defines the eight values.
UPRIGHT = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.transpose(1, 0, 2),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: a[::-1, ::-1].transpose(1, 0, 2),
    8: lambda a: np.rot90(a),
}
