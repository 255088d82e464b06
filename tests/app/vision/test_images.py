"""Photographs and masks: what is decoded, refused, and warned of, and which labels are kept."""

import io
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

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
    Photograph,
    blank_image,
    decode_image,
    decode_mask,
)
from tests.app.vision.encoded import UPRIGHT, encode, png, quadrants, with_orientation

LIMIT = 1_000_000


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_exif_orientation_is_applied(orientation: int) -> None:
    stored = quadrants()
    data = with_orientation(encode(stored, ".jpg"), orientation)
    decoded = decode_image(data, max_pixels=LIMIT).pixels.astype(int)
    expected = UPRIGHT[orientation](stored).astype(int)
    assert decoded.shape == expected.shape
    assert np.abs(decoded - expected).mean() < 12  # JPEG blurs the two edges


@pytest.mark.parametrize(
    "data",
    [
        encode(quadrants(), ".webp"),
        *(with_orientation(encode(quadrants(), ".jpg"), one) for one in UPRIGHT),
    ],
)
def test_a_blank_image_has_the_size_of_the_decoded_one(data: bytes) -> None:
    blank = blank_image(data, max_pixels=LIMIT)
    assert blank.pixels.shape == decode_image(data, max_pixels=LIMIT).pixels.shape
    assert not blank.pixels.any() and blank.warnings == ()
    with pytest.raises(ImageTooLargeError):
        blank_image(data, max_pixels=10)


@pytest.mark.parametrize("extension", [".png", ".jpg", ".webp", ".bmp", ".tiff"])
def test_formats(extension: str) -> None:
    image = quadrants()
    data = encode(image, extension)
    decoded = decode_image(data, max_pixels=LIMIT).pixels
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
    assert (decode_image(data, max_pixels=2400).pixels == quadrants()).all()
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
    decoded = decode_image(bytes.fromhex(CMYK_RED), max_pixels=LIMIT).pixels
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
def test_damaged_bytes_are_refused_or_give_an_image_within_the_limit(
    noise: bytes, extension: str
) -> None:
    data = encode(quadrants(), extension)
    for damaged in (data[:20] + noise, noise + data[len(noise) :], data[: len(noise)]):
        for decode in (decode_image, decode_mask):
            try:
                decoded = decode(damaged, max_pixels=LIMIT)
            except ImageError as error:
                assert str(error)
            else:
                values = decoded.pixels if isinstance(decoded, Photograph) else decoded.labels
                assert 0 < values.shape[0] * values.shape[1] <= LIMIT


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


def test_large_images_are_decoded_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    data, decode, busy, most = encode(np.zeros((1600, 1600), np.uint8)), cv2.imdecode, [0], [0]

    def counted(*arguments: object) -> object:
        busy[0] += 1
        most[0] = max(most[0], busy[0])
        decoded = decode(*arguments)  # type: ignore[call-overload]
        busy[0] -= 1
        return decoded

    monkeypatch.setattr(cv2, "imdecode", counted)
    with ThreadPoolExecutor(4) as pool:
        for kind in (decode_image, decode_mask):
            images = [pool.submit(kind, data, max_pixels=10**7) for _ in range(3)]
            assert all(image.result() is not None for image in images)
    assert most == [1]


def test_bomb_is_refused_before_it_is_decoded() -> None:
    bomb = png([bytes(2500)] * 20000, 20000, 1, 0)
    assert len(bomb) < 400_000
    for decode in (decode_image, decode_mask):
        with pytest.raises(ImageTooLargeError, match="20000x20000"):
            decode(bomb, max_pixels=50_000_000)


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\0\0\0\x18ftypheic" + bytes(40), "HEIC"),
        (b"\0\0\0\x18ftypavif" + bytes(40), "AVIF"),
        (b"\0\0\0\x18ftypisom" + bytes(40), "a video"),
        (b"\xff\x0a" + bytes(40), "JPEG XL"),
        (b"%PDF-1.7" + bytes(40), "PDF"),
    ],
)
def test_other_formats_are_named(data: bytes, kind: str) -> None:
    with pytest.raises(ImageError, match=f"expected a PNG, .* or GIF image, got {kind}$"):
        decode_image(data, max_pixels=LIMIT)


@pytest.mark.parametrize(("mode", "kind"), [("F", "floating point"), ("I", "whole numbers")])
def test_numbers_of_32_bits_are_refused(mode: str, kind: str) -> None:
    buffer = io.BytesIO()
    Image.new(mode, (8, 8)).save(buffer, "TIFF")
    with pytest.raises(ImageError, match=f"expected 8 or 16 bits a channel, got 32 bit {kind}"):
        decode_image(buffer.getvalue(), max_pixels=LIMIT)


def photograph(size: int = 256) -> np.ndarray:
    """Noise, soft enough for JPEG."""
    rng = np.random.default_rng(0)
    return cv2.resize(rng.integers(0, 256, (size // 8, size // 8, 3), np.uint8), (size, size))


def test_sound_pictures_have_no_warnings() -> None:
    for extension in (".png", ".jpg", ".tiff"):
        assert decode_image(encode(photograph(), extension), max_pixels=LIMIT).warnings == ()


def test_jpeg_without_its_end_marker_is_read() -> None:
    data = encode(photograph(), ".jpg")
    whole, cut = (decode_image(one, max_pixels=LIMIT) for one in (data, data[:-2]))
    assert (cut.pixels == whole.pixels).all()
    assert cut.warnings == ()


@pytest.mark.parametrize("orientation", UPRIGHT)
@pytest.mark.parametrize("end", [b"", b"\xff\xd9"])
def test_jpeg_that_lacks_a_part_says_so(orientation: int, end: bytes) -> None:
    data = with_orientation(encode(photograph(), ".jpg"), orientation)
    cut = decode_image(data[: 3 * len(data) // 4] + end, max_pixels=LIMIT)
    assert cut.warnings == ("truncated",)
    with pytest.raises(ImageError, match="most of it is missing"):
        decode_image(data[: len(data) // 4] + end, max_pixels=LIMIT)


@pytest.mark.parametrize("flags", [(), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
@pytest.mark.parametrize("rows", [0, 64, 192])
def test_a_jpeg_may_end_in_the_grey_of_missing_parts(rows: int, flags: tuple[int, ...]) -> None:
    canvas = np.full((256, 256, 3), 128, np.uint8)
    canvas[:rows] = photograph()[:rows]
    decoded = decode_image(encode(canvas, ".jpg", *flags), max_pixels=LIMIT)
    assert (decoded.pixels[rows + 16 :] == 128).all()
    assert decoded.warnings == ()


@pytest.mark.parametrize(("low", "high"), [(0, 1023), (0, 4095), (0, 16383), (7000, 9000)])
def test_range_of_16_bits_that_is_used_is_stretched(low: int, high: int) -> None:
    grey = np.linspace(0, 1, 10_000).reshape(100, 100)
    stored = np.round(low + (high - low) * grey).astype(np.uint16)
    for extension in (".png", ".tiff"):
        decoded = decode_image(encode(stored, extension), max_pixels=LIMIT)
        assert decoded.warnings == ("stretched",)
        assert np.abs(decoded.pixels[..., 0] - 255 * grey).max() < 4


def test_dark_pictures_say_so() -> None:
    for dark in (photograph() // 16, np.zeros((5, 3, 3), np.uint8), np.full((9, 9), 30, np.uint16)):
        assert decode_image(encode(dark), max_pixels=LIMIT).warnings == ("dark",)


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
    for label, box in zip(image.present, image.boxes, strict=True):
        rows, columns = (labels == label).nonzero()
        assert box.pixels() == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
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


@pytest.mark.parametrize("extension", ["JPEG", "TIFF"])
def test_lossy_mask_is_one_person(extension: str) -> None:
    mask = np.zeros((64, 64), np.uint8)
    mask[16:48, 16:48] = 255
    buffer = io.BytesIO()
    Image.fromarray(mask).save(buffer, extension, compression="jpeg")
    decoded = decode_mask(buffer.getvalue(), max_pixels=LIMIT)
    assert (decoded.labels == (mask > 0)).all()


def test_alpha_counts_where_all_else_is_black() -> None:
    alpha = np.zeros((9, 9), np.uint8)
    alpha[2:5, 3:6] = 255
    cut_out = np.dstack([np.zeros((9, 9, 3), np.uint8), alpha])
    assert (decode_mask(encode(cut_out), max_pixels=LIMIT).labels == (alpha > 0)).all()
    labels = np.dstack([alpha // 255 * 2] * 3)
    labels[:1] = 1
    for opacity in (alpha, alpha * 0 + 255):
        decoded = decode_mask(encode(np.dstack([labels, opacity])), max_pixels=LIMIT)
        assert (decoded.labels == labels[..., 0]).all()
    opaque = np.dstack([np.zeros((9, 9, 3), np.uint8), alpha * 0 + 255])
    assert decode_mask(encode(opaque), max_pixels=LIMIT).present == []


def blocks(*values: int) -> np.ndarray:
    """A row of blocks of 32 pixels."""
    return np.repeat(np.repeat(np.array([values], np.uint8), 32, axis=0), 32, axis=1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (encode(quadrants(), ".tiff"), "coloured"),
        (encode(np.arange(256, dtype=np.uint8)[None]), "255: a mask with soft edges"),
        (encode(np.zeros((4, 4), np.float32), ".tiff"), "got 32 bit floating point"),
        (encode(blocks(0, 1, 2, 5), ".jpg"), "black and white.*send labels as PNG"),
        (encode(blocks(0, 80, 160, 240), ".jpg"), "black and white.*send labels as PNG"),
    ],
)
def test_images_that_are_no_masks_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        decode_mask(data, max_pixels=LIMIT)


def test_crowds_are_not_scattered() -> None:
    """A person in every square of 16 pixels, each a mere outline."""
    y, x = np.ogrid[:320, :480]
    outlines = (np.minimum(y % 16, x % 16) == 3) * (y // 32 * 5 + x // 96 + 1)
    assert len(decode_mask(encode(outlines.astype(np.uint8)), max_pixels=LIMIT).present) == 50


@pytest.mark.parametrize("labels", [1, 2, 50])
def test_scattered_labels_are_refused(labels: int) -> None:
    y, x = np.ogrid[:128, :160]
    for pattern in ((x + y) % (labels + 1), y % (labels + 1) + 0 * x, (y + 0 * x) % 2 * labels):
        scattered = pattern.astype(np.uint8)
        for image in (scattered, scattered.T):
            with pytest.raises(ImageError, match="scattered"):
                decode_mask(encode(image), max_pixels=LIMIT)
