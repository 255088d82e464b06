"""Bodies, trust and postures of readings: what must hold whatever the models were taught."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.networks.dense import DenseNetwork
from app.networks.probabilities import softmax
from app.networks.shipped import NetworkError
from app.vision.blazepose import LandmarkNetwork, MaskNetwork, PoseReading
from app.vision.depth import HIPS
from app.vision.geometry import Box, PersonWindow
from app.vision.judgement import (
    FRAME_POSTURES,
    PhotographModels,
    TrustModel,
    load_photograph_models,
    posture_features,
    sharpened,
    trust_features,
)
from app.vision.movenet import KeypointReader
from app.vision.optics import PinholeCamera
from app.vision.people import LANDMARK_NAMES, Detection
from app.vision.person_reader import PersonReader
from index.skeleton import other_side
from tests.support.projection import project

SWAPPED = [LANDMARK_NAMES.index(other_side(name)) for name in LANDMARK_NAMES]


def posture_numbers(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return posture_features(points, np.full(33, 0.9), 0.0, 1.0, 1.0)


def test_left_and_right_count_alike() -> None:
    points = np.random.default_rng(1).normal(0, 0.4, (33, 3))
    mirrored = points[SWAPPED] * [-1, 1, 1]
    assert_allclose(posture_numbers(mirrored), posture_numbers(points), atol=1e-9)


def landmarks(*parts: str) -> list[int]:
    return [LANDMARK_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in parts]


def made_up(count: int) -> dict[str, NDArray[np.float64]]:
    """Passes of the network over people of some size, anywhere in their windows."""
    rng = np.random.default_rng(3)
    points = rng.uniform(40, 220, (count, 39, 5))
    points[..., 3:] = rng.normal(0, 3, (count, 39, 2))
    return {
        "points": points,
        "world": rng.normal(0, 0.4, (count, 39, 3)),
        "presence": rng.uniform(0.1, 0.9, count),
        "last": rng.normal(0, 1, (count, 2, 2, 288)),
        "sigmas": rng.uniform(0.02, 0.3, (count, 33)),
    }


@pytest.mark.parametrize("part", ["shoulder", "elbow", "wrist", "hip", "knee", "ankle"])
@pytest.mark.parametrize("column", [3, 4])
def test_trust_depends_on_how_surely_each_limb_is_seen_up_to_a_limit(
    part: str, column: int
) -> None:
    given = made_up(1)
    features = []
    for log_odds in (7.0, 12.0, 20.0, -7.0, -12.0, -20.0):
        given["points"][0, landmarks(part)[0], column] = log_odds
        features.append(trust_features(**given)[0])
    assert (np.abs(np.diff(features, axis=0)).max(axis=1) > 1e-4).tolist() == [
        True, False, True, True, False
    ]  # fmt: skip


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
    people = PersonReader(landmark_network, mask_network, reader, models)
    for box in walkers:
        height = round(share * box.height)
        frame = np.ascontiguousarray(street[: round(box.y) + height])
        found = Detection(Box(box.x, box.y, box.width, height), 1.0)
        judged = people.read(frame, PinholeCamera.of_frame(frame.shape), found)
        others = np.delete(judged.posture.probabilities, FRAME_POSTURES.index("standing"))
        assert others.max() < 0.5


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
        assert_allclose(models.judge(reading, camera).body.points, body.points)
        assert_allclose(
            project(camera, body.points + body.origin), reading.landmarks.positions, atol=1e-6
        )
        assert_allclose(body.points[HIPS].mean(axis=0), 0, atol=1e-9)
        assert ((body.sigmas > 0) & (body.sigmas <= 1)).all()
        # Of a person, whole and metres away.
        assert 1.2 < np.ptp(body.points[:, 1]) < 2.2
        assert 2 < body.origin[2] < 40


@pytest.mark.parametrize("odds", [-3.0, 0.0, 2.0])
def test_what_is_as_often_a_person_as_in_training_says_nothing(odds: float) -> None:
    """Six of seven windows in training show a person; trust assumes that one of two does."""
    none, one = np.zeros(1, np.float32), np.ones(1, np.float32)
    said = np.array([np.log(6) + odds, 1.0], np.float32)
    network = DenseNetwork(none, one, (np.zeros((1, 2), np.float32),), (said,))
    trust = TrustModel(network).estimate(np.zeros(1))
    assert trust.person == pytest.approx(1 / (1 + np.exp(-odds)), abs=1e-4)
    # Of right landmarks, it keeps the share in training.
    assert trust.right == pytest.approx(np.prod(1 / (1 + np.exp(-said))), abs=1e-4)


def test_a_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    file = tmp_path / "broken.npz"
    with pytest.raises(NetworkError, match="broken"):
        load_photograph_models(file)
    np.savez(file, depth=np.zeros(3))
    with pytest.raises(NetworkError, match="broken"):
        load_photograph_models(file)
