"""Masks: which values are labels of bodies, which mark one person, and what is refused."""

import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from PIL import Image

from app.vision.images import ImageError
from app.vision.masks import LabelImage, cleaned, decode_mask
from tests.app.vision.encoded import encode, png, quadrants, tiff

LIMIT = 1_000_000


def figure(height: int = 90, x: int = 60, y: int = 20, shape: tuple[int, int] = (130, 150)):
    """Share ``(H, W)``, 0 to 1, of each pixel of a frame that a standing person covers."""
    fine, unit = np.zeros((4 * shape[0], 4 * shape[1]), np.uint8), 4 * height / 90

    def place(across: float, down: float) -> tuple[int, int]:
        return round(4 * x + across * unit), round(4 * y + down * unit)

    cv2.circle(fine, place(0, 7), round(7 * unit), 255, -1)
    for ends, width in (
        (((0, 7), (0, 20)), 6), (((0, 22), (0, 48)), 17), (((-11, 20), (-15, 48)), 6),
        (((11, 20), (17, 46)), 6), (((-5, 48), (-8, 89)), 8), (((5, 48), (9, 89)), 8),
    ):  # fmt: skip
        cv2.line(fine, place(*ends[0]), place(*ends[1]), 255, round(width * unit))
    return cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA) / 255


FIGURE = figure()
HARD = FIGURE >= 0.5


def decoded(values: NDArray[np.generic], form: str = "PNG", **options: object) -> LabelImage:
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, form, **options)  # type: ignore[arg-type]
    return decode_mask(buffer.getvalue(), max_pixels=LIMIT)


def shares(first: NDArray[np.generic], second: NDArray[np.bool_]) -> float:
    """Intersection over union."""
    return float(((first > 0) & second).sum() / ((first > 0) | second).sum())


def shades(levels: int, peak: int, blur: float = 0.0) -> NDArray[np.uint8]:
    """The figure with edges of so many grey values, black and white among them."""
    soft = cv2.GaussianBlur(FIGURE, (0, 0), blur) if blur else FIGURE
    return np.round(np.round(soft * (levels - 1)) / (levels - 1) * peak).astype(np.uint8)


@given(
    levels=st.integers(3, 255),
    peak=st.sampled_from([255, 254, 200, 128]),
    blur=st.sampled_from([0.0, 0.7, 1.2]),
)
def test_soft_edges_answer_as_a_hard_mask(levels: int, peak: int, blur: float) -> None:
    mask = decoded(shades(levels, peak, blur))
    assert mask.present == [1]
    # With one grey value, the half that it stands for is a pixel wide.
    assert shares(mask.labels, HARD) > (0.93 if levels > 4 else 0.85)
    (box,), (hard,) = mask.boxes, LabelImage.of(HARD.view(np.uint8)).boxes
    assert vars(box) == pytest.approx(vars(hard), abs=2)


@pytest.mark.parametrize("labels", [(40, 80, 120), (1, 120, 255)])
def test_people_with_soft_edges_are_refused(labels: tuple[int, ...]) -> None:
    """Of 80, no one knows whether it is a person or half of 160."""
    soft = sum(label * figure(80, x=25 + 48 * row) for row, label in enumerate(labels))
    with pytest.raises(ImageError, match="soft edges must be thresholded first"):
        decoded(np.round(soft).astype(np.uint8))


@pytest.mark.parametrize("colour", [0, 90, 255])
@pytest.mark.parametrize("form", ["PNG", "WEBP", "TIFF", "LA", "palette"])
def test_alpha_over_one_colour_is_the_mask(colour: int, form: str) -> None:
    alpha = np.round(255 * FIGURE).astype(np.uint8)
    grey = np.full(alpha.shape, colour, np.uint8)
    if form == "LA":
        mask = decoded(np.dstack([grey, alpha]))
    elif form == "palette":
        buffer = io.BytesIO()
        Image.fromarray(np.dstack([grey] * 3 + [alpha])).quantize(64).save(buffer, "PNG")
        mask = decode_mask(buffer.getvalue(), max_pixels=LIMIT)
    else:
        mask = decoded(np.dstack([grey] * 3 + [alpha]), form, lossless=True, exact=True)
    assert mask.present == [1] and shares(mask.labels, HARD) > 0.95


def test_transparent_pixels_mark_nobody() -> None:
    labels = np.where(HARD, 2, 0).astype(np.uint8)
    labels[:, 75:] *= 2
    labels[:15] = 9
    alpha = np.where(np.arange(130) < 15, 0, 128).astype(np.uint8)[:, None] + 0 * labels
    shown = decoded(np.dstack([labels, alpha]))
    assert_array_equal(shown.labels, np.where(alpha > 0, labels, 0))
    opaque = np.zeros((9, 9, 4), np.uint8) + np.array([0, 0, 0, 255], np.uint8)
    assert decoded(opaque).present == []


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 7]), st.sampled_from([255, 1, 0]))
def test_specks_change_nothing(seed: int, size: int, value: int) -> None:
    """One stray block, or two pixels in a thousand; 0: of any value."""
    rng = np.random.default_rng(seed)
    mask = np.where(HARD, np.uint8(value or 255), np.uint8(0))
    if size > 1:
        row, column = rng.integers(0, 18, 2)
        mask[row : row + size, column : column + size] = value or rng.integers(1, 256)
    else:
        where = rng.random(mask.shape) < 0.002
        mask[where] = value or rng.integers(1, 256, where.sum())
    answer = decoded(mask)
    assert answer.present == [1] and shares(answer.labels, HARD) > 0.98
    assert vars(answer.boxes[0]) == pytest.approx(
        vars(LabelImage.of(HARD.view(np.uint8)).boxes[0]), abs=1
    )


@pytest.mark.parametrize("soft", [False, True])
def test_inverted_masks_are_refused(soft: bool) -> None:
    for whole in (FIGURE, figure(150), 0 * FIGURE):
        inverted = np.round(255 * (1 - (whole if soft else whole >= 0.5))).astype(np.uint8)
        with pytest.raises(ImageError, match=r"background is 0, got labels .*inverted"):
            decoded(inverted)


@pytest.mark.parametrize("height", [3, 6, 10])
def test_figures_of_a_few_pixels_are_refused(height: int) -> None:
    small = (figure(height) >= 0.5).astype(np.uint8)
    with pytest.raises(ImageError, match="figures at least 12 pixels high or wide"):
        decoded(small)
    beside = np.maximum(2 * small, figure(x=110) >= 0.5).astype(np.uint8)
    assert decoded(beside).present == [1]


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


def big(labels: NDArray[np.generic]) -> NDArray[np.generic]:
    """Every value as a square of 20 pixels."""
    return np.kron(labels, np.ones((20, 20), labels.dtype))


def test_labels_are_kept() -> None:
    labels = big(np.array([[0, 1, 1, 0], [0, 3, 2, 0]], np.uint8))
    for stored in (labels, labels.astype(np.uint16) * 1000, np.dstack([labels] * 3)):
        answer = decode_mask(encode(stored), max_pixels=LIMIT).labels
        assert answer.dtype == stored.dtype
        assert (answer == (stored if stored.ndim == 2 else labels)).all()
    lossless = encode(np.dstack([labels] * 3), ".webp", cv2.IMWRITE_WEBP_QUALITY, 101)
    assert (decode_mask(lossless, max_pixels=LIMIT).labels == labels).all()
    # If there are two values, one is the person.
    for value in (1, 2, 255):
        mask = decode_mask(encode(np.uint8(value) * (labels > 1)), max_pixels=LIMIT)
        assert (mask.labels == (labels > 1)).all()
        assert mask.present == [1]


PALETTE = (b"PLTE", bytes(range(48))), (b"tRNS", b"\0\x80")


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
@pytest.mark.parametrize("form", ["grey", "palette", "tiff"])
def test_stored_values_of_a_mask_are_kept(depth: int, form: str) -> None:
    labels = big(np.array([[0, 1, 0], [0, 2, 3]], np.uint8)) & (2**depth - 1)
    rows = np.packbits(
        np.unpackbits(labels[..., None], axis=2)[..., -depth:].reshape(40, -1), axis=1
    )
    if form == "tiff":
        data = tiff(rows.tobytes(), 60, 40, bits=depth)
    else:
        stored = [row.tobytes() for row in rows]
        data = png(stored, 60, depth, 0) if form == "grey" else png(stored, 60, depth, 3, *PALETTE)
    assert_array_equal(decode_mask(data, max_pixels=LIMIT).labels, labels)


def blocks(*values: int) -> np.ndarray:
    """A row of blocks of 32 pixels."""
    return np.repeat(np.repeat(np.array([values], np.uint8), 32, axis=0), 32, axis=1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (encode(quadrants(), ".tiff"), "coloured"),
        (encode(np.arange(256, dtype=np.uint8)[None]), "got 255 values: a mask with soft edges"),
        (encode(np.zeros((4, 4), np.float32), ".tiff"), "got 32 bit floating point"),
        (encode(blocks(0, 1, 2, 5), ".jpg"), "black and white.*send labels as PNG"),
        (encode(blocks(0, 80, 160, 240), ".jpg"), "black and white.*send labels as PNG"),
    ],
)
def test_images_that_are_no_masks_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        decode_mask(data, max_pixels=LIMIT)


def test_crowds_are_not_scattered() -> None:
    """A person in every 16x32 pixels, all of fifty labels."""
    y, x = np.ogrid[:320, :480]
    people = ((y % 32 > 10) & (x % 16 > 10)) * (y // 32 * 5 + x // 96 + 1)
    assert len(decode_mask(encode(people.astype(np.uint8)), max_pixels=LIMIT).present) == 50


@pytest.mark.parametrize("labels", [1, 2, 50])
def test_scattered_labels_are_refused(labels: int) -> None:
    y, x = np.ogrid[:128, :160]
    for pattern in ((x + y) % (labels + 1), y % (labels + 1) + 0 * x, (y + 0 * x) % 2 * labels):
        scattered = pattern.astype(np.uint8)
        for image in (scattered, scattered.T):
            with pytest.raises(ImageError, match=r"scattered|soft edges"):
                decode_mask(encode(image), max_pixels=LIMIT)


def test_small_holes_are_filled_and_large_ones_kept() -> None:
    mask = np.ones((40, 40), bool)
    mask[5, 5] = False
    mask[10:30, 10:30] = False
    filled = cleaned(mask, max_hole=0.02)
    assert filled[5, 5] and not filled[20, 20]
    assert cleaned(mask, max_hole=1.0).all()
    assert (cleaned(mask, max_hole=0) == mask).all()


def test_small_components_are_dropped() -> None:
    mask = np.zeros((30, 30), bool)
    mask[2:20, 2:10] = True
    mask[25:27, 25:27] = True
    mask[2:20, 15:20] = True
    kept = cleaned(mask, max_hole=0)
    assert not kept[25, 25] and kept[3, 16]
    assert not cleaned(mask & False, max_hole=0).any()
