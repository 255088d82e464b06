"""Actions of tracks: features of motion, the linear model, the sliding window."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.posture import EstimatedPosture
from app.tracking.actions import (
    FULL_WEIGHT_PX,
    RATE_HZ,
    ActionModel,
    ActionRecogniser,
    action_features,
    posture_factors,
    shipped_model,
    window_features,
)
from app.tracking.results import RecognisedAction
from app.tracking.seen_body import SeenBody
from app.vision.geometry import Box
from index.posture import POSTURES, PostureName, camera_up
from index.skeleton import camera_rotation, mirror_3d
from tests.app.tracking.people import person_of, standing_body
from tests.support.figures import stick_figure

PX_PER_M = 80.0
UP = np.array([0.0, 1.0, 0.0])


def swinging(seconds: float, hz: float = RATE_HZ, speed: float = 1.0) -> NDArray[np.float64]:
    """A body ``(T, 24, 3)`` that goes back and forth between two poses, in body axes."""
    rng = np.random.default_rng(1)
    first, second = stick_figure(rng), stick_figure(rng)
    share = (1 + np.sin(2 * np.pi * speed * np.arange(round(seconds * hz)) / hz)) / 2
    return first + share[:, None, None] * (second - first)


def features_of(
    poses: NDArray[np.float64], up: NDArray[np.float64] = UP, m_s: float = 0.0
) -> NDArray[np.float64]:
    """Features of a body that moves to the right."""
    return action_features(poses, up, np.outer(np.arange(len(poses)) / RATE_HZ, [m_s, 0.0]))


def body(points_3d: NDArray[np.float64]) -> SeenBody:
    return SeenBody(np.zeros(1), np.zeros(1), 1.0, PX_PER_M, 10.0, np.zeros(2), points_3d)


def recognise(
    model: ActionModel, times: list[float], action: str = "walk"
) -> list[RecognisedAction | None]:
    recogniser = ActionRecogniser(model)
    rotation = camera_rotation(30.0, 10.0)
    poses = swinging(len(times) / RATE_HZ) @ rotation.T
    return [
        recogniser.update(time, body(pose), person_of([pose], [0.8], action=action))
        for time, pose in zip(times, poses, strict=True)
    ]


@pytest.fixture(scope="module")
def undecided() -> ActionModel:
    """Two actions with the same features: the votes decide."""
    size = len(features_of(swinging(2)))
    return ActionModel(("run", "walk"), np.zeros((2, size)), np.zeros(2), 1.0)


def test_features_are_the_same_from_any_camera_and_for_mirrored_and_larger_bodies() -> None:
    poses = swinging(3)
    seen = [features_of(mirror_3d(poses)), features_of(1.3 * poses)]
    for azimuth_deg, elevation_deg in ((90, 0), (200, 35)):
        rotation = camera_rotation(azimuth_deg, elevation_deg)
        seen.append(features_of(poses @ rotation.T, camera_up(elevation_deg)))
    for features in seen:
        np.testing.assert_allclose(features, features_of(poses), atol=2e-5)


def test_features_show_tempo_and_travel() -> None:
    slow = features_of(swinging(3))
    assert np.abs(features_of(swinging(3, speed=2.0)) - slow).max() > 0.3
    changed = features_of(swinging(3), m_s=1.5) - slow
    assert np.isclose(np.abs(changed).max(), np.sqrt(1.5), atol=1e-6)


def test_features_hardly_change_with_the_frame_rate() -> None:
    coarse, fine = (
        window_features((np.arange(3 * hz) / hz).tolist(), [*map(body, swinging(3, hz, speed=0.4))])
        for hz in (10, 30)
    )
    assert np.abs(coarse - fine).max() < 0.25
    assert np.abs(coarse - fine).mean() < 0.02


def test_an_action_is_recognised_after_a_second(undecided: ActionModel) -> None:
    answers = recognise(undecided, [frame / RATE_HZ for frame in range(20)])
    assert [answer is None for answer in answers] == [True] * 10 + [False] * 10
    assert answers[-1] is not None and answers[-1].label == "walk"
    # All votes against the minimum for an action without any.
    assert answers[-1].probability == pytest.approx(1 / 1.02, abs=1e-3)


@pytest.mark.parametrize(
    ("height", "best"),
    [(2 * FULL_WEIGHT_PX, "punch"), (FULL_WEIGHT_PX, "punch"), (FULL_WEIGHT_PX / 8, "stand")],
)
def test_limbs_of_small_people_count_little(
    undecided: ActionModel, height: float, best: str
) -> None:
    """Posture decides instead, and how common an action is."""
    size = undecided.weights.shape[1]
    model = ActionModel(
        ("punch", "stand", "walk"), np.zeros((3, size)), np.array([3.0, 0.0, 0.0]), 0.0
    )
    recogniser, result = ActionRecogniser(model), None
    box = Box(0, 0, height / 2, height)
    for step, pose in enumerate(swinging(2)):
        one = person_of([pose], [0.8])
        one = replace(one, box=box)
        result = recogniser.update(step / RATE_HZ, body(pose), one, one_hot("standing"))
    assert result is not None and result.label == best


def test_after_a_gap_the_window_starts_afresh(undecided: ActionModel) -> None:
    times = [frame / RATE_HZ for frame in range(15)]
    times += [10 + frame / RATE_HZ for frame in range(15)]
    answers = recognise(undecided, times)
    assert answers[14] is not None
    assert all(answer is None for answer in answers[15:25]) and answers[-1] is not None


def test_the_shipped_model_recognises_standing() -> None:
    model = shipped_model()
    features = features_of(np.repeat(standing_body()[None], 30, axis=0))
    even = np.full(len(model.actions), 1 / len(model.actions))
    assert model.actions[int(model.probabilities(features, even).argmax())] == "stand"


@pytest.mark.parametrize(
    ("posture", "best", "worst"),
    [
        ("lying", "lie", "squat"), ("sitting", "sit", "walk"), ("walking", "walk", "arm-circle"),
        ("running", "run", "stand"), ("crouching", "squat", "lie"), ("standing", "stand", "sit"),
    ],
)  # fmt: skip
def test_an_action_goes_with_the_posture(posture: PostureName, best: str, worst: str) -> None:
    actions = shipped_model().actions
    factors = dict(zip(actions, posture_factors(actions, one_hot(posture)), strict=True))
    assert factors[best] == max(factors.values()) > 5 * factors[worst] > 0
    assert factors[worst] == min(factors.values())


def one_hot(posture: PostureName) -> EstimatedPosture:
    shares = np.array([name == posture for name in POSTURES], np.float64)
    return EstimatedPosture(posture, 1.0, shares)
