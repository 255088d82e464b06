"""Colours that tell people apart, and what counts as a change in the picture of a person."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.scene import Patch
from app.vision.geometry import Box
from app.vision.people import Silhouette
from app.vision.same_person import colour_distance, colours_of

BOX = Box(100.0, 60.0, 120.0, 320.0)


@pytest.fixture
def frame() -> NDArray[np.uint8]:
    """A person in grey before a lighter wall."""
    picture = np.full((480, 360, 3), 150, np.uint8)
    cv2.rectangle(picture, (120, 70), (200, 370), (90, 90, 90), -1)
    return picture


def test_noise_of_a_sensor_is_no_change(frame: NDArray[np.uint8]) -> None:
    patch, rng = Patch.of(frame, BOX), np.random.default_rng(0)
    noisy = frame + rng.normal(0, 4, frame.shape)
    assert patch.is_unchanged_in(np.clip(noisy, 0, 255).astype(np.uint8))


def test_a_hand_that_moves_is_a_change_but_the_person_is_still_there(
    frame: NDArray[np.uint8],
) -> None:
    patch = Patch.of(frame, BOX)
    cv2.rectangle(frame, (200, 180), (214, 200), (90, 90, 90), -1)
    assert not patch.is_unchanged_in(frame) and patch.is_shown_by(frame)


def test_clothes_of_two_people_differ() -> None:
    frame = np.zeros((60, 80, 3), np.uint8)
    frame[10:50, 10:30] = (20, 20, 200)
    frame[10:50, 40:60] = (200, 20, 20)
    crop = np.ones((40, 20), bool)
    red, blue = (
        colours_of(frame, Silhouette(crop, left, 10, "network", False)) for left in (10, 40)
    )
    assert red.shape == (80,) and red.sum() == pytest.approx(1)
    assert colour_distance(red, red) == pytest.approx(0, abs=1e-3)
    assert colour_distance(red, blue) > 0.6


def test_a_patch_is_shown_until_its_person_moves() -> None:
    rng = np.random.default_rng(3)
    floor = np.full((200, 300, 3), 120, np.uint8)
    lies = floor.copy()
    lies[120:160, 100:200] = (60, 40, 160)
    patch = Patch.of(lies, Box(95, 115, 110, 50))
    noisy = np.clip(lies + rng.normal(0, 6, lies.shape), 0, 255).astype(np.uint8)
    darker = (lies * 0.9).astype(np.uint8)
    elsewhere = floor.copy()
    elsewhere[120:160, 150:250] = (60, 40, 160)
    assert patch.is_shown_by(lies) and patch.is_shown_by(noisy) and patch.is_shown_by(darker)
    assert not patch.is_shown_by(floor) and not patch.is_shown_by(elsewhere)
