"""Frames decoded at half their size show what the whole frame shows, at the same places."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.camera import CameraSession
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scene import Patch
from app.tracking.results import TrackedPerson
from app.vision.geometry import Box, PersonWindow, sample_window
from app.vision.halved import HalvedFrame, seen_at
from app.vision.images import decode_image, halved
from tests.app.vision.encoded import encode, with_orientation


def scene(width: int, height: int) -> NDArray[np.uint8]:
    """A smooth picture, as the means of two by two pixels of a photograph are."""
    coarse = np.random.default_rng(0).integers(0, 256, (height // 24, width // 24, 3), np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def half_of(data: bytes, shape: tuple[int, ...]) -> HalvedFrame:
    found = halved(data, shape)
    assert found is not None
    return found[0]


@pytest.mark.parametrize("size", [(640, 480), (641, 479), (479, 641)])
def test_half_a_frame_shows_the_same_at_the_same_places(size: tuple[int, int]) -> None:
    data = encode(scene(*size), ".jpg", cv2.IMWRITE_JPEG_QUALITY, 95)
    whole = decode_image(data, max_pixels=10**6).pixels
    frame = half_of(data, whole.shape)
    assert frame.shape == whole.shape
    assert frame.half.shape[:2] == tuple(-(-side // 2) for side in whole.shape[:2])
    window = PersonWindow(size[0] - 280.25, size[1] - 260.5, 513.0, 20.0)
    sampled = [sample_window(one, window, 256).astype(float) for one in (whole, frame)]
    assert np.abs(sampled[0] - sampled[1]).mean() < 1.5
    assert Patch.of(whole, Box(33, 55, 211, 305)).is_unchanged_in(frame)
    assert "whole" not in vars(frame)


def test_a_picture_finer_than_half_the_frame_is_of_all_its_pixels() -> None:
    data = encode(scene(640, 480), ".jpg")
    frame = half_of(data, (480, 640, 3))
    assert seen_at(frame, 0.5) == (frame.half, 0.5)
    pixels, scale = seen_at(frame, 0.51)
    assert scale == 1
    np.testing.assert_array_equal(pixels, decode_image(data, max_pixels=10**6).pixels)
    assert seen_at(frame, 0.5)[1] == 0.5  # Whatever was decoded before.


def test_what_has_to_be_looked_at_is_decoded_whole() -> None:
    picture = scene(640, 480)
    data = encode(picture, ".jpg")
    half_of(data, picture.shape)
    half_of(with_orientation(data, 1), picture.shape)
    for other in (
        with_orientation(data, 6),  # Its sides are exchanged.
        with_orientation(data, 3),
        encode(picture, ".png"),
        data[: len(data) // 2],
        data[: len(data) // 2] + b"\xff\xd9",  # Grey from the middle on.
        encode(scene(480, 640), ".jpg"),
        b"",
    ):
        assert halved(other, picture.shape) is None


def test_large_people_are_followed_in_half_the_pixels(
    estimator: Estimator, street: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two walkers, enlarged to 800 pixels, before a camera that sways.

    Coded again with quality 90 instead of 95, the landmarks vary two to three times as much.
    """
    near = cv2.resize(street[130:290, 100:], None, fx=8, fy=8, interpolation=cv2.INTER_CUBIC)
    film = [encode(np.roll(near, 4 * step, axis=1), ".jpg") for step in range(5)]
    answers = [followed(estimator, film)]
    with monkeypatch.context() as patched:
        patched.setattr(CameraSession, "_halved_shape", lambda *_: None)
        answers.append(followed(estimator, film))
    away = [
        np.linalg.norm(one.landmarks.positions - other.landmarks.positions, axis=1) / one.box.height
        for half, whole in zip(*answers, strict=True)
        for one, other in zip(half, whole, strict=True)
        if one.landmarks and other.landmarks
    ]
    assert len(away) == 2 * len(film)
    assert np.median(away) < 0.002
    assert np.percentile(away, 90) < 0.005


def followed(estimator: Estimator, film: list[bytes]) -> list[tuple[TrackedPerson, ...]]:
    session = CameraSession(estimator)
    return [session.process(Upload(data), step / 10, 0).persons for step, data in enumerate(film)]


def test_a_dark_frame_is_dark_at_half_its_size() -> None:
    found = halved(encode(scene(640, 480) // 16, ".jpg"), (480, 640, 3))
    assert found is not None
    assert found[1] == ("dark",)
