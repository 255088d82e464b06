"""Decoding of photographs and masks, and what is refused."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from PIL import Image

from app.vision.images import (
    ImageError,
    ImageTooLargeError,
    LabelImage,
    decode_image,
    decode_mask,
    read_header,
)

LIMIT = 1_000_000


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


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_exif_orientation_is_applied(orientation: int) -> None:
    stored = quadrants()
    data = with_orientation(encode(stored, ".jpg"), orientation)
    decoded = decode_image(data, max_pixels=LIMIT).astype(int)
    expected = UPRIGHT[orientation](stored).astype(int)
    assert decoded.shape == expected.shape
    assert np.abs(decoded - expected).mean() < 12  # JPEG blurs the two edges
    stored[:10, :50], stored[10:], stored[:, 50:] = 255, 0, 0
    data = with_orientation(encode(stored[:, :, 0], ".jpg"), orientation)
    mask = decode_mask(data, max_pixels=LIMIT)
    expected = UPRIGHT[orientation](stored)[:, :, 0] > 0
    assert ((mask.labels == 1) == expected).mean() > 0.95


@pytest.mark.parametrize("extension", [".png", ".jpg", ".webp", ".bmp", ".tiff"])
def test_formats(extension: str) -> None:
    image = quadrants()
    data = encode(image, extension)
    header = read_header(data)
    assert (header.width, header.height) == (60, 40)
    decoded = decode_image(data, max_pixels=LIMIT)
    assert decoded.dtype == np.uint8
    assert np.abs(decoded.astype(int) - image).mean() < 12


def gif(image: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image[:, :, ::-1]).save(buffer, "GIF")
    return buffer.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        gif(quadrants()),
        encode(np.dstack([quadrants(), np.full((40, 60), 128, np.uint8)])),  # Alpha is dropped.
        encode(quadrants().astype(np.uint16) * 257),
    ],
    ids=["gif", "alpha", "16 bits"],
)
def test_other_formats_become_eight_bits_in_three_channels(data: bytes) -> None:
    assert (decode_image(data, max_pixels=2400) == quadrants()).all()
    with pytest.raises(ImageTooLargeError):
        decode_image(data, max_pixels=2399)


# A 16x16 CMYK JPEG in the manner of Adobe (inverted), plain red.
CMYK_RED = (
    "ffd8ffee000e41646f626500640000000000ffdb004300281c1e231e19282321232d2b28303c64413c37373c"
    "7b585d4964918099968f808c8aa0b4e6c3a0aadaad8a8cc8ffcbdaeef5ffffff9bc1fffffffaffe6fdfff8ff"
    "c000140800100010044311004d11005911004b1100ffc4001500010100000000000000000000000000000005"
    "ffc40014100100000000000000000000000000000000ffda000e0443004d0059004b00003f00b28a8ab20000"
    "00ffd9"
)


def test_cmyk_jpeg() -> None:
    decoded = decode_image(bytes.fromhex(CMYK_RED), max_pixels=LIMIT)
    assert decoded.shape == (16, 16, 3)
    blue, green, red = decoded.reshape(-1, 3).mean(axis=0)
    assert red > 180 > 80 > max(blue, green)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"garbage that is no image at all, but long enough to hold a header",
        b"\xff\xd8\xff",
        b"\xff\xd8\xff\xda" + bytes(40),
        b"\x89PNG\r\n\x1a\n",
        b"GIF89a\x01",
        b"RIFF\0\0\0\0WEBPVP8X",
        b"RIFF\0\0\0\0WEBPnone",
        b"II*\0\xff\xff\xff\x7f",
        b"BM" + bytes(10),
        b"BM" + bytes(60),
    ],
)
def test_other_bytes_are_refused(data: bytes) -> None:
    for decode in (decode_image, decode_mask):
        with pytest.raises(ImageError) as caught:
            decode(data, max_pixels=LIMIT)
        assert str(caught.value)


@given(st.binary(max_size=200), st.sampled_from([".png", ".jpg", ".webp", ".bmp", ".tiff"]))
def test_damaged_bytes_raise_image_errors_only(noise: bytes, extension: str) -> None:
    data = encode(quadrants(), extension)
    for damaged in (data[:20] + noise, noise + data[len(noise) :], data[: len(noise)]):
        for decode in (decode_image, decode_mask):
            with contextlib.suppress(ImageError):
                decode(damaged, max_pixels=LIMIT)


def test_chunk_that_announces_gigabytes_is_refused() -> None:
    image = encode(quadrants())
    for kind, place in ((b"tEXt", 33), (b"IDAT", image.index(b"IDAT") - 4)):
        data = image[:place] + struct.pack(">I", 2**31 - 1) + kind + bytes(1000)
        for decode in (decode_image, decode_mask):
            with pytest.raises(ImageError, match="broken"):
                decode(data, max_pixels=LIMIT)


def test_image_of_a_million_empty_segments_is_refused() -> None:
    jpeg, image = encode(quadrants(), ".jpg"), encode(quadrants())
    with pytest.raises(ImageError, match="too many segments"):
        decode_image(jpeg[:2] + b"\xff\xe5\0\2" * 1_000_000 + jpeg[2:], max_pixels=LIMIT)
    empty = struct.pack(">I4sI", 0, b"IDAT", zlib.crc32(b"IDAT"))
    place = image.index(b"IDAT") - 4
    with pytest.raises(ImageError, match="broken"):
        decode_image(image[:place] + empty * 100_000 + image[place:], max_pixels=LIMIT)


def test_bomb_is_refused_before_it_is_decoded() -> None:
    bomb = png([bytes(2500)] * 20000, 20000, 1, 0)
    assert len(bomb) < 400_000
    for decode in (decode_image, decode_mask):
        with pytest.raises(ImageTooLargeError, match="20000x20000"):
            decode(bomb, max_pixels=50_000_000)


@given(
    labels=arrays(
        st.sampled_from([np.uint8, np.uint16]),
        st.tuples(st.integers(1, 9), st.integers(1, 9)),
        elements=st.sampled_from([0, 0, 0, 1, 2, 9, 255]),
    )
)
def test_labels_are_found_with_their_borders(labels: NDArray[np.uint8]) -> None:
    image = LabelImage.of(labels)
    assert image.present == [label for label in np.unique(labels).tolist() if label]
    rest = labels.copy()
    rows, columns = image.part.shape
    within = rest[image.top : image.top + rows, image.left : image.left + columns]
    assert (within == image.part).all()
    within[:] = 0
    assert not rest.any()
    for edge in (image.part[:1], image.part[-1:], image.part[:, :1], image.part[:, -1:]):
        assert edge.any() or not image.present
    assert (image.merged().labels == (labels > 0)).all()


def test_labels_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        LabelImage.of(np.zeros(3, np.uint8))


def test_labels_are_kept() -> None:
    labels = np.array([[0, 1, 1], [0, 3, 2]], np.uint8)
    for stored in (labels, labels.astype(np.uint16) * 1000, np.dstack([labels] * 3)):
        decoded = decode_mask(encode(stored), max_pixels=LIMIT).labels
        assert decoded.dtype == stored.dtype
        assert (decoded == (stored if stored.ndim == 2 else labels)).all()
    lossless = encode(np.dstack([labels] * 3), ".webp", cv2.IMWRITE_WEBP_QUALITY, 101)
    assert (decode_mask(lossless, max_pixels=LIMIT).labels == labels).all()
    # If there are two values, one is the person.
    for value in (1, 2, 255):
        mask = decode_mask(encode(np.uint8(value) * (labels > 1)), max_pixels=LIMIT)
        assert (mask.labels == (labels > 1)).all()
        assert mask.present == [1]


PALETTE = (b"PLTE", bytes(range(48))), (b"tRNS", b"\0\x80")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (png([bytes([0, 255, 1, 255, 2, 0])], 3, 8, 4), [0, 1, 2]),  # Alpha is dropped.
        (png([bytes([0b01100000])], 8, 1, 0), [0, 1, 1, 0, 0, 0, 0, 0]),
        (png([bytes([0b00011011])], 4, 2, 0), [0, 1, 2, 3]),
        (png([bytes([0x12])], 2, 4, 0), [1, 2]),
        (png([bytes([0x01, 0x2F])], 4, 4, 3, *PALETTE), [0, 1, 2, 15]),
        (png([bytes([0, 1, 2, 15])], 4, 8, 3, *PALETTE), [0, 1, 2, 15]),
    ],
)
def test_stored_values_of_a_mask_are_kept(data: bytes, expected: list[int]) -> None:
    assert decode_mask(data, max_pixels=LIMIT).labels.tolist() == [expected]


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_exif_orientation_is_applied_to_palette_images(orientation: int) -> None:
    image = Image.fromarray(np.array([[0, 1, 2], [0, 3, 3]], np.uint8), "P")
    image.putpalette(range(48))
    buffer, exif = io.BytesIO(), Image.Exif()
    exif[0x112] = orientation
    image.save(buffer, "PNG", exif=exif)
    decoded = decode_mask(buffer.getvalue(), max_pixels=LIMIT)
    expected = UPRIGHT[orientation](np.asarray(image)[..., None])[..., 0]
    assert decoded.labels.tolist() == expected.tolist()


@pytest.mark.parametrize("extension", ["JPEG", "TIFF"])
def test_lossy_mask_is_one_person(extension: str) -> None:
    mask = np.zeros((64, 64), np.uint8)
    mask[16:48, 16:48] = 255
    buffer = io.BytesIO()
    Image.fromarray(mask).save(buffer, extension, compression="jpeg")
    decoded = decode_mask(buffer.getvalue(), max_pixels=LIMIT)
    assert (decoded.labels == (mask > 0)).all()


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (quadrants(), "coloured"),
        (np.arange(256, dtype=np.uint8)[None], "255: a mask with soft edges"),
        (np.zeros((4, 4), np.float32), "whole numbers, got float32"),
    ],
)
def test_images_that_are_no_masks_are_refused(mask: np.ndarray, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        decode_mask(encode(mask, ".tiff"), max_pixels=LIMIT)
