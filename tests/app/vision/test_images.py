"""Photographs: what is decoded, refused, and warned of."""

import io
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from app.vision.images import ImageError, ImageTooLargeError, Photograph, blank_image, decode_image
from app.vision.masks import decode_mask
from tests.app.vision.encoded import UPRIGHT, encode, png, quadrants, tiff, with_orientation

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
        encode(np.dstack([quadrants(), np.full((40, 60), 255, np.uint8)])),
        encode(quadrants().astype(np.uint16) * 257),
    ],
    ids=["gif", "alpha", "16 bits"],
)
def test_other_formats_become_eight_bits_in_three_channels(data: bytes) -> None:
    assert (decode_image(data, max_pixels=2400).pixels == quadrants()).all()
    with pytest.raises(ImageTooLargeError):
        decode_image(data, max_pixels=2399)


@pytest.mark.parametrize("form", ["PNG", "WEBP", "TIFF", "palette"])
@given(hidden=st.integers(0, 255))
def test_what_is_transparent_shows_grey(form: str, hidden: int) -> None:
    shown = np.zeros((40, 60), np.uint8)
    shown[10:30, 20:40] = 255
    colours = np.where(shown[..., None] > 0, quadrants(), np.uint8(hidden))
    rgba = Image.fromarray(np.dstack([colours[..., ::-1], shown]))
    buffer = io.BytesIO()
    if form == "palette":
        rgba.quantize(16).save(buffer, "PNG")
    else:
        rgba.save(buffer, form, lossless=True, exact=True)
    decoded = decode_image(buffer.getvalue(), max_pixels=LIMIT).pixels
    assert (decoded == np.where(shown[..., None] > 0, quadrants(), 128)).all()


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
    with pytest.raises(ImageError, match="too many segments"):
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


@pytest.mark.parametrize(
    ("own_limit", "said"), [(None, "got 20000x20000"), (10**8, "more than Pillow reads")]
)
def test_bomb_is_refused_before_it_is_decoded(
    monkeypatch: pytest.MonkeyPatch, own_limit: int | None, said: str
) -> None:
    """A program of others may keep Pillow's own limit."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", own_limit)
    bomb = png([bytes(2500)] * 20000, 20000, 1, 0)
    assert len(bomb) < 400_000
    for decode in (decode_image, decode_mask):
        with pytest.raises(ImageTooLargeError, match=said):
            decode(bomb, max_pixels=50_000_000)


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\0\0\0\x18ftypheic" + bytes(40), "HEIC"),
        (b"\0\0\0\x18ftypavif" + bytes(40), "AVIF"),
        (b"\0\0\0\x18ftypisom" + bytes(40), "a video"),
        (b"\xff\x0a" + bytes(40), "JPEG XL"),
        (b"%PDF-1.7" + bytes(40), "PDF"),
        (b"PK\x03\x04" + bytes(40), "a ZIP archive"),
    ],
)
def test_other_formats_are_named(data: bytes, kind: str) -> None:
    with pytest.raises(ImageError, match=f"expected a PNG, .* or GIF image, got {kind}$"):
        decode_image(data, max_pixels=LIMIT)


def photograph(size: int = 256) -> np.ndarray:
    """Noise, soft enough for JPEG."""
    rng = np.random.default_rng(0)
    return cv2.resize(rng.integers(0, 256, (size // 8, size // 8, 3), np.uint8), (size, size))


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


def test_dark_pictures_say_so() -> None:
    for dark in (photograph() // 16, np.zeros((5, 3, 3), np.uint8), np.full((9, 9), 30, np.uint16)):
        assert decode_image(encode(dark), max_pixels=LIMIT).warnings == ("dark",)


def test_half_transparent_colours_are_mixed_with_grey() -> None:
    half = np.dstack([quadrants(), np.full((40, 60), 128, np.uint8)])
    mixed = decode_image(encode(half), max_pixels=LIMIT).pixels.astype(int)
    assert np.abs(mixed - (quadrants().astype(int) + 128) / 2).max() <= 2


def test_jpeg_without_its_end_marker_is_read() -> None:
    data = encode(photograph(), ".jpg")
    whole, cut = (decode_image(one, max_pixels=LIMIT) for one in (data, data[:-2]))
    assert (cut.pixels == whole.pixels).all()
    assert cut.warnings == ()


@pytest.mark.parametrize(("low", "high"), [(0, 1023), (0, 4095), (0, 16383), (7000, 9000)])
def test_range_of_16_bits_that_is_used_is_stretched(low: int, high: int) -> None:
    grey = np.linspace(0, 1, 10_000).reshape(100, 100)
    stored = np.round(low + (high - low) * grey).astype(np.uint16)
    for extension in (".png", ".tiff"):
        decoded = decode_image(encode(stored, extension), max_pixels=LIMIT)
        assert decoded.warnings == ("stretched",)
        assert np.abs(decoded.pixels[..., 0] - 255 * grey).max() < 4


@pytest.mark.parametrize("samples", [1, 3])
def test_tiff_that_lacks_strips_says_so(samples: int) -> None:
    picture = photograph(64)[..., :samples]
    rows = [row.tobytes() for row in picture[..., ::-1]]
    for lost, warnings in ((0, ()), (16, ("truncated",))):
        stored = b"".join(rows[: 64 - lost])
        decoded = decode_image(tiff(stored, 64, 64, samples=samples, rows=16), max_pixels=LIMIT)
        assert decoded.warnings == warnings
        assert (decoded.pixels[: 64 - lost] == picture[: 64 - lost]).all()
    for stored in (b"", rows[0]):
        with pytest.raises(ImageError, match="most of it is missing"):
            decode_image(tiff(stored, 64, 64, samples=samples, rows=16), max_pixels=LIMIT)
