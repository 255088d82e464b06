"""The models that rendered people teach: what must hold whatever they were taught."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from app.vision.blazepose import LandmarkNetwork, PoseReading, sample_map
from app.vision.depth import HIPS, DenseNetwork, decode_depths, network_depths, softmax
from app.vision.geometry import Box, PersonWindow
from app.vision.judgement import (
    FRAME_POSTURES,
    FramePosture,
    photograph_models,
    posture_features,
    sharpened,
)
from app.vision.models import network_path
from app.vision.optics import PinholeCamera
from app.vision.people import LANDMARK_NAMES
from app.vision.tflite import NetworkError

SWAPPED = [
    LANDMARK_NAMES.index(n.replace("left", "?").replace("right", "left").replace("?", "right"))
    for n in LANDMARK_NAMES
]


def dense(seed: int, sizes: tuple[int, ...]) -> DenseNetwork:
    generator = np.random.default_rng(seed)
    pairs = list(pairwise(sizes))
    return DenseNetwork(
        generator.normal(size=sizes[0]).astype(np.float32),
        generator.uniform(0.5, 2, sizes[0]).astype(np.float32),
        tuple(generator.normal(size=pair).astype(np.float32) for pair in pairs),
        tuple(generator.normal(size=pair[1]).astype(np.float32) for pair in pairs),
    )


def test_a_network_comes_back_from_its_arrays() -> None:
    network = dense(1, (7, 5, 3))
    arrays = network.arrays("one") | dense(2, (4, 2)).arrays("other")
    features = np.random.default_rng(3).normal(size=(6, 7))
    again = DenseNetwork.of(arrays, "one")
    assert_allclose(again(features), network(features), atol=0.05)
    assert again(features).shape == (6, 3)


def test_without_hidden_layers_a_network_is_linear() -> None:
    network = dense(1, (4, 2))
    one, other = np.random.default_rng(3).normal(size=(2, 1, 4))
    middle = network((one + other) / 2)
    assert_allclose(middle, (network(one) + network(other)) / 2, rtol=1e-4, atol=1e-5)


def test_layers_that_do_not_fit_are_refused() -> None:
    one, other = dense(1, (7, 5)), dense(1, (4, 3))
    with pytest.raises(ValueError, match="expected weights of shape"):
        DenseNetwork(one.means, one.scales, one.weights + other.weights, one.biases + other.biases)


def test_probabilities_sum_to_one_however_large_the_scores() -> None:
    given = softmax(np.array([[1e4, 0.0, -1e4], [1.0, 1.0, 1.0]]))
    assert_allclose(given.sum(axis=1), 1)
    assert_allclose(given[1], 1 / 3)


def test_maps_are_seen_in_the_middle_of_their_cells() -> None:
    maps = np.random.default_rng(0).normal(size=(2, 8, 8, 3)).astype(np.float32)
    points = np.zeros((2, 39, 5), np.float32)
    points[:, :33, 0], points[:, :33, 1] = 32 * 5 + 16, 32 * 2 + 16
    assert_allclose(sample_map(maps, points), np.repeat(maps[:, None, 2, 5], 33, 1), atol=1e-6)
    points[:, :33, :2] = [-500, 9999]
    assert_allclose(sample_map(maps, points), np.repeat(maps[:, None, 7, 0], 33, 1), atol=1e-6)


def test_no_residual_leaves_the_networks_depth() -> None:
    own = network_depths(np.random.default_rng(0).normal(size=(4, 39, 3)))
    depths, sigmas = decode_depths(np.zeros((4, 66)), own)
    assert_allclose(depths, own, atol=1e-12)
    assert_allclose(depths[:, HIPS].mean(axis=1), 0, atol=1e-12)
    assert_allclose(sigmas, 0.1)


def posture_numbers(points: NDArray[np.float64]) -> NDArray[np.float64]:
    one = np.ones(1)
    return posture_features(points[None], np.full((1, 33), 0.9), 0 * one, one, one)[0]


def test_left_and_right_count_alike() -> None:
    points = np.random.default_rng(1).normal(0, 0.4, (33, 3))
    mirrored = points[SWAPPED] * [-1, 1, 1]
    assert_allclose(posture_numbers(mirrored), posture_numbers(points), atol=1e-9)


def test_degenerate_bodies_have_finite_numbers() -> None:
    assert np.isfinite(posture_numbers(np.zeros((33, 3)))).all()


def test_probabilities_of_a_posture_are_named() -> None:
    given = FramePosture(np.array([0.1, 0.1, 0.5, 0.1, 0.1, 0.1]))
    assert given.likeliest == "crouching" and given.of("crouching") == 0.5
    with pytest.raises(ValueError, match="six probabilities"):
        FramePosture(np.ones(3))


def test_a_person_who_is_hardly_seen_is_classified_less_surely() -> None:
    scores = np.repeat([[2.0, 0, 0, 0, 0, 0]], 3, axis=0)
    given = sharpened(scores, np.array([0.02, 0.5, 0.95]), np.array([0.1, 0.2]))
    assert (np.diff(given[:, 0]) > 0).all()
    assert_allclose(given[1], softmax(np.exp(0.1) * scores[1]))


@pytest.fixture(scope="module")
def readings(
    landmark_network: LandmarkNetwork, street: NDArray[np.uint8], walkers: list[Box]
) -> list[PoseReading]:
    return [landmark_network.read(street, PersonWindow.about_box(box)) for box in walkers]


def test_walkers_stand_and_are_people(
    readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    models, camera = photograph_models(), PinholeCamera.of_frame(street.shape)
    for reading in readings:
        judged = models.judge(reading, camera)
        assert judged.posture.likeliest == "standing"
        assert judged.trust.person > 0.8
        assert 0 <= judged.trust.right <= judged.trust.person <= 1


def test_bodies_lie_on_the_lines_of_sight_of_their_landmarks(
    readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    camera = PinholeCamera.of_frame(street.shape, 50)
    for reading in readings:
        body = photograph_models().body(reading, camera)
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
    readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    models = photograph_models()
    narrow, wide = (
        models.body(readings[1], PinholeCamera.of_frame(street.shape, fov)) for fov in (40, 80)
    )
    assert wide.origin[2] < narrow.origin[2]


def test_a_reading_without_its_pass_is_refused(
    readings: list[PoseReading], street: NDArray[np.uint8]
) -> None:
    bare = replace(readings[0], network_pass=None)
    with pytest.raises(ValueError, match="pass of the network"):
        photograph_models().body(bare, PinholeCamera.of_frame(street.shape))


def test_asphalt_is_nobody(landmark_network: LandmarkNetwork, street: NDArray[np.uint8]) -> None:
    models, camera = photograph_models(), PinholeCamera.of_frame(street.shape)
    for box in (Box(100, 200, 30, 80), Box(60, 30, 30, 80)):
        reading = landmark_network.read(street, PersonWindow.about_box(box))
        assert models.judge(reading, camera).trust.person < 0.5


def test_what_ships_is_small() -> None:
    assert network_path("photograph_models").stat().st_size < 3_000_000
    posture = photograph_models().posture
    for network in (posture.by_body, posture.by_surroundings):
        assert network.biases[-1].shape == (len(FRAME_POSTURES),)


def test_a_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    file = tmp_path / "broken.npz"
    with pytest.raises(NetworkError, match="broken"):
        photograph_models(file)
    np.savez(file, depth=np.zeros(3))
    with pytest.raises(NetworkError, match="broken"):
        photograph_models(file)
