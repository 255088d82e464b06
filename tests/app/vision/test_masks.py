"""Label images: which values they keep, and which are refused."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from PIL import Image

from app.vision.images import ImageError, LabelImage, decode_mask
from tests.app.vision.encoded import UPRIGHT, encode, png, quadrants, with_orientation

LIMIT = 1_000_000


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


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_exif_orientation_is_applied(orientation: int) -> None:
    stored = np.zeros((40, 60), np.uint8)
    stored[:10, :50] = 255
    data = with_orientation(encode(stored, ".jpg"), orientation)
    mask = decode_mask(data, max_pixels=LIMIT)
    expected = UPRIGHT[orientation](stored[..., None])[..., 0] > 0
    assert ((mask.labels == 1) == expected).mean() > 0.95


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
