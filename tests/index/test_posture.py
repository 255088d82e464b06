"""Postures of skeletons built by hand, one for each rule, and what must not change them."""

from collections.abc import Mapping
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from index.posture import (
    LOW,
    MIN_RUNNING_SPEED_M_S,
    MIN_WALKING_SPEED_M_S,
    POSTURES,
    PostureName,
    camera_up,
    classify_postures,
    lying_elevation_deg,
)
from index.skeleton import JOINT_NAMES, POINTS, camera_rotation

UP = np.array([0.0, 1.0, 0.0])

# Degrees in the sagittal plane: 0 hangs straight down, 90 points ahead, 180 up, 270 back.
HANGING = {
    "tilt": 0.0, "left_thigh": 0.0, "right_thigh": 0.0, "left_shank": 0.0, "right_shank": 0.0,
    "left_arm": 0.0, "right_arm": 0.0,
}  # fmt: skip


def body(**angles: float) -> NDArray[np.float64]:
    """A skeleton ``(24, 3)`` in body axes, legs 0.84 m long.

    Parameters
    ----------
    **angles : float
        Degrees from the vertical of ``tilt`` (of the trunk, ahead), of thighs, shanks and
        arms; ``thighs``, ``shanks`` and ``arms`` set both sides.
    """
    both = {
        f"{side}_{part[:-1]}": angles[part]
        for part in {"thighs", "shanks", "arms"} & angles.keys()
        for side in ("left", "right")
    }
    angle = {**HANGING, **both, **{k: v for k, v in angles.items() if k in HANGING}}
    assert angle.keys() == HANGING.keys()

    def along(degrees: float) -> NDArray[np.float64]:
        return np.array([0.0, -np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])

    trunk = along(180.0 - angle["tilt"])
    points = {"pelvis": np.zeros(3)}
    for name, height in (("spine", 0.12), ("chest", 0.3), ("neck", 0.52), ("head", 0.66)):
        points[name] = height * trunk
    for side, sign in (("left", 1.0), ("right", -1.0)):
        aside = np.array([sign, 0.0, 0.0])
        points[f"{side}_shoulder"] = 0.46 * trunk + 0.18 * aside
        arm = along(angle[f"{side}_arm"])
        points[f"{side}_elbow"] = points[f"{side}_shoulder"] + 0.28 * arm
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + 0.26 * arm
        points[f"{side}_hip"] = -0.04 * trunk + 0.1 * aside
        points[f"{side}_knee"] = points[f"{side}_hip"] + 0.42 * along(angle[f"{side}_thigh"])
        shank = along(angle[f"{side}_shank"])
        points[f"{side}_ankle"] = points[f"{side}_knee"] + 0.42 * shank
        # The foot at a right angle to the shank.
        toe = along(angle[f"{side}_shank"] + 90.0)
        points[f"{side}_toe"] = points[f"{side}_ankle"] + 0.03 * shank + 0.16 * toe
    joints = np.array([points[name] for name in JOINT_NAMES])
    return np.concatenate([joints, np.tile(joints[4], (POINTS - len(joints), 1))])


BODIES: Mapping[str, tuple[PostureName, NDArray[np.float64]]] = {
    "upright": ("standing", body()),
    "leaning ahead": ("standing", body(tilt=30)),
    "one arm raised": ("standing", body(left_arm=180)),
    "one leg raised": ("standing", body(left_thigh=80)),
    "both arms raised": ("arms_raised", body(arms=170)),
    "bowing": ("bending", body(tilt=70)),
    "picking up from the floor": ("bending", body(tilt=100, thighs=20, shanks=-20)),
    "on a chair": ("sitting", body(thighs=85)),
    "on a high stool": ("sitting", body(thighs=72)),
    "on a chair, feet drawn in": ("sitting", body(thighs=85, shanks=-30, tilt=15)),
    "on a chair, leaning ahead": ("sitting", body(thighs=85, shanks=-30, tilt=50)),
    "rising from a chair": ("crouching", body(thighs=75, shanks=-38, tilt=45)),
    "on a chair, leaning back": ("sitting", body(thighs=88, tilt=-20)),
    "on the floor, legs ahead": ("sitting", body(thighs=90, shanks=90)),
    "on the floor, knees drawn up": ("sitting", body(thighs=140, shanks=30, tilt=10)),
    "on the floor, heels drawn in": ("sitting", body(thighs=150, shanks=-20, tilt=10)),
    "squatting": ("crouching", body(thighs=115, shanks=-35, tilt=40)),
    "squatting, well bent": ("crouching", body(thighs=115, shanks=-35, tilt=57, arms=100)),
    "half a squat": ("crouching", body(thighs=70, shanks=-40, tilt=40)),
    "kicking": ("standing", body(left_thigh=100, left_shank=100)),
    "lifting from the floor": ("bending", body(tilt=78, thighs=75, shanks=-40)),
    "on both knees, toes tucked in": ("kneeling", body(shanks=-105)),
    "on both knees, resting on the heels": ("kneeling", body(thighs=60, shanks=-110, tilt=15)),
    "on one knee": ("kneeling", body(right_shank=-105, left_thigh=90)),
    "bent over the raised knee": (
        "kneeling", body(right_shank=-105, left_thigh=110, left_shank=10, tilt=57, arms=10),
    ),
    "prostrate, the seat on the heels": (
        "kneeling", body(tilt=115, thighs=60, shanks=-110, arms=170),
    ),
    "prostrate, the seat up": ("kneeling", body(tilt=120, shanks=-105, arms=170)),
    "on all fours": ("crawling", body(tilt=85, shanks=-105)),
    "on hands and feet": ("crawling", body(tilt=100, thighs=50, shanks=-60)),
    "on the back": ("lying", body(tilt=-90, thighs=90, shanks=90, arms=90)),
    "on the belly": ("lying", body(tilt=90, thighs=-90, shanks=-90, arms=-90)),
    "on the back, knees drawn up": ("lying", body(tilt=-90, thighs=140, shanks=40, arms=90)),
    "on the back, arms stretched up": ("lying", body(tilt=-90, thighs=90, shanks=90, arms=180)),
}  # fmt: skip
"""By description: the posture and the skeleton."""

SKELETONS = np.stack([skeleton for _, skeleton in BODIES.values()])
EXPECTED = [posture for posture, _ in BODIES.values()]


def postures(
    points: NDArray[np.floating], up: NDArray[np.floating] = UP, speed: float = 0.0
) -> list[PostureName]:
    return [POSTURES[row] for row in classify_postures(points, up, speed)]


def rotated(axis: int, degrees: float) -> NDArray[np.float64]:
    """Matrix of a rotation about an axis."""
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = cosine
    matrix[first, second], matrix[second, first] = -sine, sine
    return matrix


@pytest.mark.parametrize("name", BODIES)
def test_rules(name: str) -> None:
    posture, skeleton = BODIES[name]
    assert postures(skeleton[None]) == [posture]


def test_every_rule_is_tested() -> None:
    assert {*EXPECTED, "walking", "running"} == set(POSTURES) == set(get_args(PostureName))
    assert set(LOW) <= set(POSTURES)


@pytest.mark.parametrize("side", [-90.0, 90.0])
def test_lying_on_the_side(side: float) -> None:
    """Stretched and curled up."""
    for skeleton in (body(), body(thighs=90, shanks=-20, tilt=20)):
        assert postures((skeleton @ rotated(2, side).T)[None]) == ["lying"]


@pytest.mark.parametrize(
    ("speed", "posture"),
    [
        (0.0, "standing"),
        (MIN_WALKING_SPEED_M_S - 0.01, "standing"),
        (MIN_WALKING_SPEED_M_S, "walking"),
        (MIN_RUNNING_SPEED_M_S - 0.01, "walking"),
        (MIN_RUNNING_SPEED_M_S, "running"),
    ],
)
def test_speed_separates_walking_and_running(speed: float, posture: str) -> None:
    assert postures(body(left_thigh=25, right_thigh=-25)[None], speed=speed) == [posture]


@given(yaw=st.floats(-180, 180), scale=st.floats(0.5, 2.0), shift=st.floats(-5, 5))
def test_heading_size_and_place_do_not_matter(yaw: float, scale: float, shift: float) -> None:
    moved = scale * SKELETONS @ rotated(1, yaw).T + np.array([shift, -shift, 2 * shift])
    assert postures(moved) == EXPECTED


@given(azimuth=st.floats(0, 360), elevation=st.floats(-5, 70))
def test_posture_does_not_depend_on_the_camera(azimuth: float, elevation: float) -> None:
    seen = SKELETONS @ camera_rotation(azimuth, elevation).T
    assert postures(seen, camera_up(elevation)) == EXPECTED


@given(
    azimuth=st.floats(0, 360),
    elevation=st.floats(0, 70),
    side=st.floats(0, 360),
    tail_first=st.booleans(),
)
def test_elevation_of_a_level_trunk_is_the_cameras(
    azimuth: float, elevation: float, side: float, tail_first: bool
) -> None:
    level = body(arms=30) @ rotated(1, side).T @ rotated(0, 90.0 if tail_first else -90.0).T
    # A trunk that lies across the picture is level for every elevation.
    if abs(np.cos(np.deg2rad(azimuth))) < 0.05:
        return
    seen = (level @ camera_rotation(azimuth, elevation).T)[None]
    assert lying_elevation_deg(seen) == pytest.approx([elevation], abs=1e-6)
