"""Grey PNGs read without OpenCV: the same pixels, or nothing."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from app.vision.png_grey import read_grey_png

NONE, SUB, UP, AVERAGE, PAETH = range(5)


def some_mask(seed: int, height: int, width: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    mask = np.zeros((height, width), np.uint8)
    for label in range(1, 4):
        top, left = rng.integers(height), rng.integers(width)
        mask[top : top + rng.integers(1, 40), left : left + rng.integers(1, 20)] = label * 80
    return mask


def encoded(pixels: NDArray[np.uint8], filters: NDArray[np.integer], **header: int) -> bytes:
    """A PNG whose rows are filtered as told; of filters 0 to 2."""
    rows = []
    for number, (row, kind) in enumerate(zip(pixels, filters, strict=True)):
        left = np.concatenate([np.zeros(1, np.uint8), row[:-1]])
        above = pixels[number - 1] if number else np.zeros_like(row)
        difference = row - {NONE: np.zeros_like(row), SUB: left, UP: above}[int(kind)]
        rows.append(bytes([int(kind)]) + difference.tobytes())
    height, width = pixels.shape
    head = {"depth": 8, "colour": 0, "compression": 0, "filter": 0, "interlace": 0, **header}
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        chunk(kind, content)
        for kind, content in (
            (b"IHDR", struct.pack(">IIBBBBB", width, height, *head.values())),
            (b"IDAT", zlib.compress(b"".join(rows))),
            (b"IEND", b""),
        )
    )


def chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


@pytest.mark.parametrize(
    "change",
    [
        lambda stream: b"",
        lambda stream: stream[:1],
        lambda stream: b"\x79\x9c" + stream[2:],
        lambda stream: b"\x78\xbb" + stream[2:],
        lambda stream: stream[:-4],
        lambda stream: stream[:-1] + bytes([stream[-1] ^ 1]),
    ],
    ids=["empty", "one byte", "method", "dictionary", "no checksum", "wrong checksum"],
)
def test_a_stream_that_is_not_whole_is_left_alone(change: Callable[[bytes], bytes]) -> None:
    png = encoded(np.eye(5, dtype=np.uint8), np.zeros(5, int))
    start, end = png.index(b"IDAT") - 4, png.index(b"IEND") - 4
    changed = change(png[start + 8 : end - 4])
    broken = png[:start] + chunk(b"IDAT", changed) + png[end:]
    assert read_grey_png(broken) is None
    assert cv2.imdecode(np.frombuffer(broken, np.uint8), cv2.IMREAD_UNCHANGED) is None


@pytest.mark.parametrize("kind", [NONE, SUB, UP])
@pytest.mark.parametrize("value", [0, 255])
def test_masks_of_one_value(value: int, kind: int) -> None:
    mask = np.full((5, 7), value, np.uint8)
    assert_array_equal(read_grey_png(encoded(mask, np.full(5, kind))), mask)


@given(
    seed=st.integers(0, 1000),
    height=st.integers(1, 60),
    width=st.integers(1, 60),
    filters=st.lists(st.sampled_from([NONE, SUB, UP]), min_size=60, max_size=60),
)
def test_rows_filtered_anyhow_give_the_pixels_back(
    seed: int, height: int, width: int, filters: list[int]
) -> None:
    mask = some_mask(seed, height, width)
    data = encoded(mask, np.array(filters[:height]))
    assert_array_equal(read_grey_png(data), mask)
    assert_array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), mask)


@pytest.mark.parametrize("kind", [0, *(1 << bit for bit in range(3, 8)), 0xF8])
def test_what_opencv_writes_is_read_as_opencv_reads_it_or_left_to_it(kind: int) -> None:
    mask = some_mask(7, 240, 320)
    data = cv2.imencode(".png", mask, [cv2.IMWRITE_PNG_FILTER, kind])[1].tobytes()
    found = read_grey_png(data)
    if kind in (0, cv2.IMWRITE_PNG_FILTER_NONE, cv2.IMWRITE_PNG_FILTER_SUB):
        assert found is not None
    if found is not None:
        assert_array_equal(found, mask)


@pytest.mark.parametrize(
    "pixels",
    [np.zeros((4, 5, 3), np.uint8), np.zeros((4, 5, 4), np.uint8), np.zeros((4, 5), np.uint16)],
)
def test_other_pngs_are_left_alone(pixels: NDArray[np.generic]) -> None:
    assert read_grey_png(cv2.imencode(".png", pixels)[1].tobytes()) is None


@pytest.mark.parametrize("header", [{"depth": 4}, {"colour": 3}, {"interlace": 1}, {"filter": 1}])
def test_other_headers_are_left_alone(header: dict[str, int]) -> None:
    mask = some_mask(1, 20, 20)
    assert read_grey_png(encoded(mask, np.zeros(20, int), **header)) is None


@pytest.mark.parametrize("kind", [b"eXIf", b"tRNS", b"PLTE", b"acTL"])
def test_chunks_that_change_the_picture_are_left_alone(kind: bytes) -> None:
    data = encoded(some_mask(1, 20, 20), np.zeros(20, int))
    with_chunk = data[:33] + chunk(kind, b"\0" * 6) + data[33:]
    assert read_grey_png(with_chunk) is None
    harmless = data[:33] + chunk(b"tEXt", b"a\0b") + data[33:]
    assert read_grey_png(harmless) is not None


@given(seed=st.integers(0, 100), place=st.floats(0, 1), flip=st.integers(1, 255))
def test_a_broken_png_is_never_read_otherwise(seed: int, place: float, flip: int) -> None:
    mask = some_mask(seed, 30, 30)
    data = bytearray(encoded(mask, np.full(30, SUB)))
    # Not in the signature, which is looked at before, nor after the last row.
    position = 8 + int(place * (len(data) - 9 - 12))
    data[position] ^= flip
    found = read_grey_png(bytes(data))
    assert found is None or np.array_equal(found, mask)


@pytest.mark.parametrize("rows", [19, 21])
def test_more_or_fewer_rows_than_announced_are_left_alone(rows: int) -> None:
    data = encoded(some_mask(1, rows, 20), np.zeros(rows, int))
    head = struct.pack(">IIBBBBB", 20, 20, 8, 0, 0, 0, 0)
    assert read_grey_png(data[:8] + chunk(b"IHDR", head) + data[33:]) is None
