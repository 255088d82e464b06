"""Silhouettes normalised to 128x48, rotated, compared by their outlines, packed."""

import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptor.silhouette import (
    HEIGHT,
    WIDTH,
    Placement,
    normalise,
    outline_distances,
    pack,
    principal_axis_deg,
    rotate_silhouette,
    unpack,
)

Mask = NDArray[np.uint8]


def smooth_person(height: int) -> Mask:
    """The same person drawn as ellipses and limbs, about ``height`` pixels tall."""
    canvas = np.zeros((height + 40, height), np.uint8)
    unit, left, top = height / 100, height / 2, 20

    def at(x: float, y: float) -> tuple[int, int]:
        return round(left + x * unit), round(top + y * unit)

    cv2.ellipse(canvas, at(0, 8), (round(5 * unit), round(8 * unit)), 0, 0, 360, 1, -1)
    cv2.ellipse(canvas, at(0, 34), (round(10 * unit), round(20 * unit)), 0, 0, 360, 1, -1)
    for x0, y0, x1, y1 in ((-5, 48, -12, 95), (5, 48, 7, 97), (-8, 20, -17, 50), (8, 20, 15, 2)):
        cv2.line(canvas, at(x0, y0), at(x1, y1), 1, round(6 * unit))
    return canvas


@st.composite
def masks(draw: st.DrawFn) -> Mask:
    """Any mask with a pixel set, up to 40 px a side, from single pixels to noise."""
    height, width = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    density = draw(st.sampled_from([0.02, 0.3, 0.9, 1.0]))
    seed = draw(st.integers(0, 2**16))
    mask = (np.random.default_rng(seed).random((height, width)) < density).astype(np.uint8)
    mask[draw(st.integers(0, height - 1)), draw(st.integers(0, width - 1))] = 1
    return mask


@pytest.mark.parametrize(
    ("height", "width", "expected"),
    [
        (256, 40, (128, 20)),  # tall: fills the height
        (64, 96, (32, 48)),  # wide: fills the width
        (8, 3, (128, 48)),  # the frame's own ratio, enlarged 16 times
        (1, 1, (48, 48)),
    ],
)
def test_rectangles_keep_their_aspect_ratio_and_touch_the_frame(
    height: int, width: int, expected: tuple[int, int]
) -> None:
    silhouette, _ = normalise(np.ones((height, width), np.uint8))
    rows, columns = silhouette.any(axis=1), silhouette.any(axis=0)
    # Enlarged pixels fade to the background: less than half a source pixel may go at each side.
    scale = max(1, expected[0] / height)
    assert abs(rows.sum() - expected[0]) <= scale
    assert abs(columns.sum() - expected[1]) <= scale
    assert_array_equal(silhouette, silhouette[::-1, ::-1])


@given(mask=masks(), top=st.integers(0, 9), left=st.integers(0, 9))
def test_ignores_translation(mask: Mask, top: int, left: int) -> None:
    moved = np.pad(mask, ((top, 3), (left, 5)))
    there, placement = normalise(moved)
    here, original = normalise(mask)
    assert_array_equal(there, here)
    assert_allclose(
        placement.to_normalised([[left, top]]), original.to_normalised([[0, 0]]), atol=1e-9
    )


@pytest.mark.parametrize("times", [2, 3])
def test_ignores_scale_but_for_the_outline(times: int) -> None:
    small, _ = normalise(smooth_person(300))
    large, _ = normalise(np.kron(smooth_person(300), np.ones((times, times), np.uint8)))
    assert_differ_only_at_the_outline(small, large)
    # Of the outline itself, no more than resampling moves.
    assert (small != large).sum() < 0.02 * small.sum()


def assert_differ_only_at_the_outline(one: Mask, other: Mask) -> None:
    kernel = np.ones((3, 3), np.uint8)
    assert not (other & ~cv2.dilate(one, kernel) & 1).any()
    assert not (cv2.erode(one, kernel) & ~other & 1).any()


@given(mask=masks())
def test_mirrored_mask_gives_mirrored_silhouette(mask: Mask) -> None:
    straight, _ = normalise(mask)
    flipped, _ = normalise(mask[:, ::-1])
    # Pixels covered by exactly half, too: rounding does not decide.
    assert_array_equal(flipped[:, ::-1], straight)


@given(mask=masks())
def test_placement_maps_the_bounding_box_into_the_middle_of_the_frame(mask: Mask) -> None:
    _, placement = normalise(mask)
    rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
    # Outer edges of the box: half a pixel beyond the centres of its outermost pixels.
    edges = [[columns[0] - 0.5, rows[0] - 0.5], [columns[-1] + 0.5, rows[-1] + 0.5]]
    (left, top), (right, bottom) = placement.to_normalised(edges)
    assert left + right == pytest.approx(WIDTH - 1, abs=1e-9)
    assert top + bottom == pytest.approx(HEIGHT - 1, abs=1e-9)
    assert min(WIDTH - (right - left), HEIGHT - (bottom - top)) == pytest.approx(0, abs=1e-9)


@given(mask=masks())
def test_is_never_empty(mask: Mask) -> None:
    assert normalise(mask)[0].any()


@pytest.mark.parametrize("shape", [(1_000_000, 12), (12, 1_000_000)], ids=str)
def test_extremely_thin_masks_take_memory_in_proportion_to_their_pixels(
    shape: tuple[int, int],
) -> None:
    mask = np.ones(shape, np.uint8)
    tracemalloc.start()
    silhouette, _ = normalise(mask)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert silhouette.any()
    assert peak < 10 * mask.nbytes


def test_refuses_a_mask_with_channels() -> None:
    with pytest.raises(ValueError, match=r"shape \(H, W\), got shape \(4, 4, 3\)"):
        normalise(np.ones((4, 4, 3)))


@pytest.mark.parametrize("shape", [(5, 5), (0, 3)])
def test_refuses_an_empty_mask(shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="at least one pixel set, got an empty one"):
        normalise(np.zeros(shape))


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_placement_refuses_a_scale_that_has_no_inverse(scale: float) -> None:
    with pytest.raises(ValueError, match="expected a positive scale and finite offsets"):
        Placement(scale, 0.0, 0.0)


@given(seed=st.integers(0, 2**16), count=st.integers(0, 3))
def test_pack_round_trip(seed: int, count: int) -> None:
    silhouettes = np.random.default_rng(seed).integers(0, 2, (count, HEIGHT, WIDTH), np.uint8)
    bits = pack(silhouettes)
    assert bits.shape == (count, HEIGHT * WIDTH // 8)
    assert_array_equal(unpack(bits), silhouettes)


def ellipse(angle_deg: float, long: int = 60, short: int = 20) -> Mask:
    """An ellipse that stands, rotated clockwise."""
    mask = np.zeros((160, 160), np.uint8)
    # OpenCV measures from the horizontal, clockwise.
    cv2.ellipse(mask, (80, 80), (long, short), angle_deg + 90, 0, 360, 1, -1)
    return mask


def apart_deg(one: float, other: float) -> float:
    """Between axes, which have no direction."""
    return abs((one - other + 90) % 180 - 90)


@given(angle=st.integers(-90, 90), short=st.integers(5, 40))
def test_principal_axis_of_an_ellipse_is_its_long_axis(angle: int, short: int) -> None:
    found = principal_axis_deg(ellipse(angle, short=short))
    assert -90 <= found <= 90
    assert apart_deg(found, angle) < 1.0


@pytest.mark.parametrize("angle", [-170.0, -90.0, -53.0, 8.0, 90.0, 121.0, 180.0])
class TestRotate:
    def test_pixels_map_back_to_the_mask(self, angle: float) -> None:
        mask = smooth_person(240)
        rotated, inverse = rotate_silhouette(mask, angle)
        x, y = np.rint(pixels(rotated) @ inverse[:, :2].T + inverse[:, 2]).astype(int).T
        assert mask[y, x].mean() > 0.97
        # All of it: as large, up to the scale.
        area = rotated.sum() * abs(np.linalg.det(inverse[:, :2]))
        assert area == pytest.approx(mask.sum(), rel=0.04)

    def test_place_and_size_in_the_frame_do_not_matter(self, angle: float) -> None:
        person = smooth_person(120)
        masks = (person, np.pad(person, ((60, 9), (0, 20))), 255 * person.repeat(2, 0).repeat(2, 1))
        first, *others = (rotate_silhouette(mask, angle)[0] for mask in masks)
        for other in others:
            assert_differ_only_at_the_outline(first, other)


def pixels(silhouette: Mask) -> NDArray[np.float64]:
    return np.argwhere(silhouette)[:, ::-1].astype(float)


@pytest.mark.parametrize("shape", [(12, 1_000_000), (40_000, 3)])
def test_masks_beyond_the_limits_of_opencv_are_rotated(shape: tuple[int, int]) -> None:
    mask = np.ones(shape, np.uint8)
    assert abs(principal_axis_deg(mask)) == pytest.approx(90 if shape[1] > shape[0] else 0, abs=1)
    rotated, inverse = rotate_silhouette(mask, 90.0)
    assert rotated.any()
    rows, columns = np.nonzero(rotated)
    ends = np.stack([columns, rows], axis=1)[[0, -1]] @ inverse[:, :2].T + inverse[:, 2]
    assert np.abs(ends).max() == pytest.approx(max(shape), rel=0.1)


@pytest.fixture
def square() -> NDArray[np.uint8]:
    silhouette = np.zeros((128, 48), np.uint8)
    silhouette[40:80, 10:30] = 1
    return silhouette


def test_outline_distance_grows_with_a_shift_and_stays_below_it(square: NDArray[np.uint8]) -> None:
    shifts = np.arange(1, 15)
    distances = outline_distances(square, np.stack([np.roll(square, s, axis=1) for s in shifts]))
    assert (np.diff(distances) > 0).all()
    # Every outline pixel has its own image at the distance of the shift.
    assert (distances <= shifts + 0.1).all()
