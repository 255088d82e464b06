"""Bodies, trust and postures of readings: what must hold whatever the models were taught."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.blazepose import LandmarkNetwork, MaskNetwork, PoseReading
from app.vision.depth import HIPS
from app.vision.geometry import Box, PersonWindow
from app.vision.judgement import (
    FRAME_POSTURES,
    FramePosture,
    PhotographModels,
    load_photograph_models,
    posture_features,
    sharpened,
)
from app.vision.models import network_path
from app.vision.movenet import KeypointReader
from app.vision.odds import softmax
from app.vision.optics import PinholeCamera
from app.vision.people import LANDMARK_NAMES
from app.vision.person_reader import PersonReader
from app.vision.tflite import NetworkError

SWAPPED = [
    LANDMARK_NAMES.index(n.replace("left", "?").replace("right", "left").replace("?", "right"))
    for n in LANDMARK_NAMES
]


def posture_numbers(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return posture_features(points, np.full(33, 0.9), 0.0, 1.0, 1.0)


def test_left_and_right_count_alike() -> None:
    points = np.random.default_rng(1).normal(0, 0.4, (33, 3))
    mirrored = points[SWAPPED] * [-1, 1, 1]
    assert_allclose(posture_numbers(mirrored), posture_numbers(points), atol=1e-9)


def test_degenerate_bodies_have_finite_numbers() -> None:
    assert np.isfinite(posture_numbers(np.zeros((33, 3)))).all()


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_the_posture_of_legs_beyond_the_border_is_no_other_than_standing(
    models: PhotographModels,
    landmark_network: LandmarkNetwork,
    mask_network: MaskNetwork,
    reader: KeypointReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
    share: float,
) -> None:
    people = PersonReader(landmark_network, mask_network, reader)
    for box in walkers:
        height = round(share * box.height)
        frame = np.ascontiguousarray(street[: round(box.y) + height])
        reading = people.read(frame, Box(box.x, box.y, box.width, height))
        judged = models.judge(reading, PinholeCamera.of_frame(frame.shape))
        others = np.delete(judged.posture.probabilities, FRAME_POSTURES.index("standing"))
        assert others.max() < 0.5


def test_probabilities_of_a_posture_are_named() -> None:
    given = FramePosture(np.array([0.1, 0.1, 0.5, 0.1, 0.1, 0.1]))
    assert given.of("crouching") == 0.5
    with pytest.raises(ValueError, match="six probabilities"):
        FramePosture(np.ones(3))


def test_a_person_who_is_hardly_seen_is_classified_less_surely() -> None:
    scores = np.repeat([[2.0, 0, 0, 0, 0, 0]], 3, axis=0)
    given = sharpened(scores, np.array([0.02, 0.5, 0.95]), np.array([0.1, 0.2]))
    assert (np.diff(given[:, 0]) > 0).all()
    assert_allclose(given[1], softmax(np.exp(0.1) * scores[1]))


@pytest.fixture(scope="module")
def models() -> PhotographModels:
    return load_photograph_models()


@pytest.fixture(scope="module")
def readings(
    landmark_network: LandmarkNetwork, street: NDArray[np.uint8], walkers: list[Box]
) -> list[PoseReading]:
    return [landmark_network.read(street, PersonWindow.about_box(box)) for box in walkers]


def test_walkers_stand_and_are_people(
    models: PhotographModels, readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    camera = PinholeCamera.of_frame(street.shape)
    for reading in readings:
        judged = models.judge(reading, camera)
        assert judged.posture.of("standing") > 0.5
        assert judged.trust.person > 0.8
        assert 0 <= judged.trust.right <= judged.trust.person <= 1


def test_bodies_lie_on_the_lines_of_sight_of_their_landmarks(
    models: PhotographModels, readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    camera = PinholeCamera.of_frame(street.shape, 50)
    for reading in readings:
        body = models.body(reading, camera)
        assert_allclose(
            camera.project(body.points + body.origin), reading.landmarks.positions, atol=1e-6
        )
        assert_allclose(body.points[HIPS].mean(axis=0), 0, atol=1e-9)
        assert_allclose(body.sight @ body.sight.T, np.eye(3), atol=1e-9)
        assert ((body.sigmas > 0) & (body.sigmas <= 1)).all()
        # Of a person, whole and metres away.
        assert 1.2 < np.ptp(body.points[:, 1]) < 2.2
        assert 2 < body.origin[2] < 40


def test_a_wider_view_brings_people_nearer(
    models: PhotographModels, readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    narrow, wide = (
        models.body(readings[1], PinholeCamera.of_frame(street.shape, fov)) for fov in (40, 80)
    )
    assert wide.origin[2] < narrow.origin[2]


def test_a_reading_without_its_pass_is_refused(
    models: PhotographModels, readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    bare = replace(readings[0], network_pass=None)
    with pytest.raises(ValueError, match="pass of the network"):
        models.body(bare, PinholeCamera.of_frame(street.shape))


def test_asphalt_is_nobody(
    models: PhotographModels, landmark_network: LandmarkNetwork, street: NDArray[np.uint8]
) -> None:
    camera = PinholeCamera.of_frame(street.shape)
    for box in (Box(100, 200, 30, 80), Box(60, 30, 30, 80)):
        reading = landmark_network.read(street, PersonWindow.about_box(box))
        assert models.judge(reading, camera).trust.person < 0.5


def test_what_ships_is_small(models: PhotographModels) -> None:
    assert network_path("photograph_models").stat().st_size < 2_500_000
    assert models.posture.network.biases[-1].shape == (len(FRAME_POSTURES),)


def test_a_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    file = tmp_path / "broken.npz"
    with pytest.raises(NetworkError, match="broken"):
        load_photograph_models(file)
    np.savez(file, depth=np.zeros(3))
    with pytest.raises(NetworkError, match="broken"):
        load_photograph_models(file)
