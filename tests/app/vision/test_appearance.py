"""What counts as a change in the small picture of a person."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.appearance import Patch
from app.vision.geometry import Box

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


def test_other_light_is_a_change_but_the_person_is_still_there(frame: NDArray[np.uint8]) -> None:
    patch, lighter = Patch.of(frame, BOX), frame + np.uint8(8)
    assert not patch.is_unchanged_in(lighter) and patch.is_shown_by(lighter)


def test_an_empty_place_shows_nobody(frame: NDArray[np.uint8]) -> None:
    patch = Patch.of(frame, BOX)
    assert not patch.is_shown_by(np.full_like(frame, 150))
