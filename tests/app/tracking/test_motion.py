"""The velocity over the ground, from projections of people who move, and their headings."""

from collections.abc import Sequence

import numpy as np
import pytest

from app.tracking.motion import (
    MIN_TURNED_DEG,
    STILL,
    GroundMotion,
    GroundVelocity,
    Heading,
    HeadingFilter,
    ground_path,
)
from app.vision.geometry import Box
from index.skeleton import camera_rotation

DISTANCE_M, FOCAL_PX = 12.0, 1200.0


def walk(
    elevation_deg: float, velocity: tuple[float, float], seconds: float = 1.0
) -> GroundVelocity:
    """The velocity measured of a person who moves right and away, by their projected centre."""
    rotation = camera_rotation(0.0, elevation_deg)
    motion, found = GroundMotion(), STILL
    for timestamp in np.arange(0, seconds + 1e-9, 0.1):
        # World axes: x to the right of the picture, z towards the camera.
        right, away = (timestamp - seconds) * np.array(velocity)
        x, y, z = rotation @ np.array([right, 0.0, -away]) + np.array([0.0, 0.0, DISTANCE_M])
        px_per_m = FOCAL_PX / z
        found = motion.update(
            timestamp, Box(x * px_per_m - 20, y * px_per_m - 80, 40, 160), px_per_m, elevation_deg
        )
    return found


@pytest.mark.parametrize("elevation_deg", [10.0, 25.0, 45.0])
@pytest.mark.parametrize(
    "velocity", [(1.2, 0.0), (-1.2, 0.0), (0.0, 1.2), (0.0, -1.2), (0.8, -0.8)]
)
def test_recovers_the_velocity(elevation_deg: float, velocity: tuple[float, float]) -> None:
    found = walk(elevation_deg, velocity)
    assert found.right == pytest.approx(velocity[0], abs=0.2)
    assert found.away == pytest.approx(velocity[1], abs=0.25)


def test_two_frames_give_no_velocity() -> None:
    assert walk(20.0, (5.0, 0.0), seconds=0.1) == STILL


def test_only_the_last_second_counts() -> None:
    motion = GroundMotion()
    for frame in range(60):
        x = 20.0 * frame if frame < 30 else 600.0
        found = motion.update(frame / 10, Box(x, 0, 40, 160), 100.0, 20.0)
    assert found.speed == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("elevation_deg", "metres"), [(30.0, 1.0), (0.0, 0.5 / 0.35)])
def test_a_path_goes_down_the_picture_towards_the_camera(
    elevation_deg: float, metres: float
) -> None:
    """Seen from low, no farther than the floor of the sine allows."""
    path = ground_path(np.array([[0.0, 0.0], [80.0, 40.0]]), 80.0, elevation_deg)
    np.testing.assert_allclose(path[1], [1.0, metres])


BESIDE_DEG = 90 - MIN_TURNED_DEG
TO_THE_LEFT = GroundVelocity(-1.2, 0.0, 1.2)


def follow(
    azimuths_deg: Sequence[float], velocity: GroundVelocity = STILL, step_s: float = 0.1
) -> list[Heading]:
    headings = HeadingFilter()
    return [
        headings.update(step_s * number, np.array([azimuth]), np.ones(1), 0.0, velocity)
        for number, azimuth in enumerate(azimuths_deg)
    ]


def test_a_single_frame_turns_no_one() -> None:
    assert all(turn.front for turn in follow([30.0] * 10 + [150.0] + [30.0] * 10))


def test_a_person_seen_from_the_side_stays_on_one_side() -> None:
    noise = np.random.default_rng(3).normal(0, 25, 100)
    sides = [turn.front for turn in follow((80 + noise).tolist())]
    frames = [abs(80 + error) < 90 for error in noise]
    assert np.mean(np.diff(frames)) > 0.2
    assert np.mean(np.diff(sides)) < 0.05


@pytest.mark.parametrize("step_s", [1 / 30, 0.1, 0.5])
def test_turning_round_is_followed(step_s: float) -> None:
    frames = round(1 / step_s)
    turns = follow([20.0] * frames + [160.0] * frames, step_s=step_s)
    assert turns[frames - 1].front_probability > 0.9
    assert not turns[-1].front
    assert turns[-1].front_probability < 0.1


def test_people_go_where_they_face() -> None:
    """Of two equal readings, the one counts that faces where the person walks."""
    headings = HeadingFilter()
    for number in range(20):
        heading = headings.update(
            0.1 * number, np.array([90.0, -90.0]), np.full(2, 0.5), 0.0, TO_THE_LEFT
        )
    ahead, behind = heading.log_likelihood(np.array([90.0, -90.0]))
    assert ahead > behind + 1


@pytest.mark.parametrize(
    ("front", "azimuth_deg", "expected_deg"),
    [
        (True, 30.0, 30.0), (True, 100.0, BESIDE_DEG), (True, -100.0, -BESIDE_DEG),
        (False, 150.0, 150.0), (False, 80.0, 180 - BESIDE_DEG), (False, -80.0, BESIDE_DEG - 180),
    ],
)  # fmt: skip
def test_the_nearest_azimuth_of_a_side(
    front: bool, azimuth_deg: float, expected_deg: float
) -> None:
    heading = Heading(np.full(36, 1 / 36), front)
    assert heading.on_visible_side(azimuth_deg) == pytest.approx(expected_deg)
