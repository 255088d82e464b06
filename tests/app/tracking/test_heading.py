"""Headings: single frames are doubted, steady evidence is believed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from app.tracking.motion import MIN_TURNED_DEG, STILL, GroundVelocity, Heading, HeadingFilter

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
