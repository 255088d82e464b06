"""People as differences from the empty scene."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.geometry import Box
from app.vision.silhouettes import cut_out_changed, foreground, upright_regions


def figure(frame: NDArray[np.uint8], left: int, colour: tuple[int, int, int]) -> np.ndarray:
    """Paint a stick person, 100 px tall, and return its mask."""
    mask = np.zeros(frame.shape[:2], np.uint8)
    cv2.circle(mask, (left + 20, 28), 8, 1, -1)
    cv2.rectangle(mask, (left + 7, 38), (left + 33, 72), 1, -1)
    cv2.rectangle(mask, (left + 9, 72), (left + 17, 119), 1, -1)
    cv2.rectangle(mask, (left + 23, 72), (left + 31, 119), 1, -1)
    frame[mask > 0] = colour
    return mask > 0


def iou(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / (first | second).sum())


@pytest.fixture
def empty() -> np.ndarray:
    """A pavement with a light gradient, tiles and a few strong edges."""
    rng = np.random.default_rng(3)
    scene = np.linspace(90, 190, 200)[None, :, None] + rng.normal(0, 3, (140, 200, 3))
    scene[::20] -= 25
    scene[:, 150:155] = 40
    return np.clip(scene, 0, 255).astype(np.uint8)


def with_person(empty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    frame = empty.copy()
    return frame, figure(frame, 60, (30, 40, 150))


@pytest.mark.parametrize(("gain", "offset"), [(1, 0), (0.8, 6), (1.25, -10)])
@pytest.mark.parametrize("noise", [0, 6])
def test_exposure_and_noise_are_no_change(
    empty: np.ndarray, gain: float, offset: float, noise: float
) -> None:
    frame, person = with_person(empty)
    grain = np.random.default_rng(5).normal(0, noise, frame.shape)
    frame = np.clip(frame * gain + offset + grain, 0, 255).astype(np.uint8)
    assert iou(foreground(frame, empty), person) > 0.85


def test_shadow_is_no_change(empty: np.ndarray) -> None:
    frame, person = with_person(empty)
    shadow = np.zeros(frame.shape[:2], bool)
    shadow[100:130, 95:140] = True
    shadow &= ~person
    frame[shadow] = (frame[shadow] * 0.65).astype(np.uint8)
    changed = foreground(frame, empty)
    assert changed[shadow].mean() < 0.25
    assert iou(changed, person) > 0.7


def test_person_is_detected_and_cut_out(empty: np.ndarray) -> None:
    frame, person = with_person(empty)
    changed = foreground(frame, empty)
    found = upright_regions(changed, 50)
    assert len(found) == 1 and found[0].score > 0.5
    one = cut_out_changed(changed, [found[0].box])[0]
    assert one is not None and one.segmenter == "background" and not one.truncated
    assert iou(one.mask(frame.shape), person) > 0.85


def test_pixels_of_overlapping_boxes_go_to_the_nearer_middle(empty: np.ndarray) -> None:
    """Two people side by side, and a box outside the frame."""
    frame = empty.copy()
    people = [figure(frame, left, (30, 40, 150)) for left in (40, 78)]
    boxes = [Box(35, 18, 60, 104), Box(60, 18, 60, 104), Box(500, 0, 10, 10)]
    *found, outside = cut_out_changed(foreground(frame, empty), boxes)
    assert outside is None
    for one, person in zip(found, people, strict=True):
        assert one is not None
        assert iou(one.mask(frame.shape), person) > 0.8


def test_background_of_another_size_is_refused(empty: np.ndarray) -> None:
    with pytest.raises(ValueError, match="background of shape"):
        foreground(empty[:-1], empty)
