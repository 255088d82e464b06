"""JPEG and PNG without what decoding does not need: the same pixels, in bounded time."""

import io
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from app.vision.files import NotPlainError, plain
from app.vision.images import ImageError, decode_image
from tests.app.vision.encoded import UPRIGHT, encode, quadrants, with_orientation
from tests.support.expensive import jpeg, png, with_exif

LIMIT = 1_000_000
SCAN = b"\xff\xda"


def saved(form: str, mode: str = "RGB", **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(quadrants()[..., ::-1]).convert(mode).save(buffer, form, **options)
    return buffer.getvalue()


def test_files_of_pixels_alone_stay_as_they_are() -> None:
    progressive = encode(quadrants(), ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    for data in (encode(quadrants(), ".jpg"), progressive, encode(quadrants()), b"RIFF", b""):
        assert plain(data) is data


@pytest.mark.parametrize("form", ["JPEG", "PNG"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", UPRIGHT)
def test_only_the_orientation_of_exif_is_left(form: str, order: str, orientation: int) -> None:
    exif = Image.Exif()
    exif.endian = order
    exif.update({0x010E: "a description", 0x0112: orientation, 0x9286: "a note"})
    text = PngInfo()
    text.add_text("Comment", "x" * 1000, zip=True)
    options = {"pnginfo": text} if form == "PNG" else {"comment": "x" * 1000, "quality": 95}
    data = saved(form, exif=exif, icc_profile=bytes(3000), **options)
    left = plain(data)
    assert len(left) < len(data)
    with Image.open(io.BytesIO(left)) as image:
        assert dict(image.getexif()) == {0x0112: orientation}
    expected = UPRIGHT[orientation](quadrants()).astype(int)
    decoded = decode_image(data, max_pixels=LIMIT).pixels.astype(int)
    assert decoded.shape == expected.shape
    assert np.abs(decoded - expected).mean() < (12 if form == "JPEG" else 1)


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
@pytest.mark.parametrize("quality", [5, 75, 100])
def test_what_encoders_write_has_few_scans(mode: str, quality: int) -> None:
    data = saved("JPEG", mode, progressive=True, quality=quality, comment="x")
    assert data.count(SCAN) > 5
    decode_image(data, max_pixels=LIMIT)


def test_bytes_behind_the_picture_of_a_camera_are_no_scans() -> None:
    """Phones put a film behind a photograph."""
    data = encode(quadrants(), ".jpg") + SCAN * 1000
    assert plain(data) is data
    assert decode_image(data, max_pixels=LIMIT).warnings == ()


@pytest.mark.parametrize("is_progressive", [True, False])
def test_scans_that_change_nothing_are_refused(is_progressive: bool) -> None:
    assert plain(jpeg(30, (64, 64), progressive=is_progressive))
    with pytest.raises(ImageError, match=r"got a JPEG of 10\d\d scans, more than 32"):
        decode_image(jpeg(1000, (64, 64), progressive=is_progressive), max_pixels=LIMIT)
    # A marker that decoders do not know, or find elsewhere than in a segment, hides no scans.
    one = jpeg(2, (64, 64), progressive=is_progressive)
    place = one.rindex(SCAN)
    hidden = one[:place] + b"\xff\x02\xff\xff" + one[place:-2] * 100
    with pytest.raises(ImageError, match="scans"):
        decode_image(hidden, max_pixels=LIMIT)


def test_texts_and_tags_are_not_unpacked() -> None:
    for data in (png(3), png(3, behind=False), with_exif(jpeg(0, (64, 64)))):
        assert len(plain(data)) < 1000
        assert decode_image(data, max_pixels=LIMIT).pixels.shape == (64, 64, 3)


def test_exif_behind_the_pixels_of_a_png_counts() -> None:
    data = encode(quadrants())
    exif = with_orientation(b"\xff\xd8", 6)[12:]
    chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif + bytes(4)
    end = data.index(b"IEND") - 4
    decoded = decode_image(data[:end] + chunk + data[end:], max_pixels=LIMIT)
    assert decoded.pixels.shape == (60, 40, 3)


@given(st.binary(max_size=300), st.sampled_from([".jpg", ".png"]), st.integers(2, 60))
def test_any_bytes_give_a_file_or_an_error(noise: bytes, extension: str, at: int) -> None:
    data = encode(quadrants(), extension)
    for damaged in (data[:at] + noise, data[:at] + noise + data[at:]):
        try:
            assert plain(plain(damaged)) == plain(damaged)
        except NotPlainError as error:
            assert str(error)


@pytest.mark.parametrize("filler", [b"\xff", b"\xff\0", b"\xff\x01", b"\xff\xe5\0\2", b"\0"])
def test_filled_headers_are_read_in_linear_time(filler: bytes) -> None:
    with pytest.raises(NotPlainError):
        plain(b"\xff\xd8\xff" + filler * 1_000_000)
