"""One person read: the window that is right of several, fused with MoveNet's keypoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.estimation.finder import distinct_bodies
from app.estimation.parameters import DUPLICATE_BODY_DISTANCE
from app.vision.blazepose import Reading
from app.vision.geometry import (
    COCO_NAMES,
    COCO_ROWS,
    LANDMARK_NAMES,
    Box,
    ObservedKeypoints,
    PersonWindow,
)
from app.vision.person_reader import (
    AGREES_WITHIN,
    PersonReader,
    attenuate_visibility_at_border,
    fuse,
    quality,
    trunk_roll_deg,
    window_beyond_border,
)
from app.vision.windows import window_about


@pytest.fixture(scope="module")
def readings(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> list[Reading]:
    return [person_reader.read(street, box) for box in walkers]


def moved(reading: Reading, x: float, y: float) -> Reading:
    landmarks = reading.landmarks
    return replace(
        reading, landmarks=replace(landmarks, positions=landmarks.positions + np.array([x, y]))
    )


def test_of_several_windows_the_right_one_is_taken(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Asphalt, a neighbour and the person upside down are told from the person."""
    height = walkers[2].height
    wrong = [
        window_about(Box(100, 200, 30, 80)),
        window_about(walkers[0]),
        window_about(walkers[2], 180.0),
    ]
    expected = person_reader.read(street, walkers[2])
    for window in wrong:
        found = person_reader.read(street, walkers[2], None, [window])
        apart = found.landmarks.positions - expected.landmarks.positions
        assert np.linalg.norm(apart, axis=1).mean() < 0.05 * height


def test_better_agreement_and_a_window_that_stays_are_better(readings: list[Reading]) -> None:
    reading = readings[2]
    same = reading.landmarks.keypoints()
    sure = ObservedKeypoints(same.positions, np.ones(17))
    assert quality(reading, sure) > quality(moved(reading, 10, 0), sure)
    assert quality(reading, sure) > quality(replace(reading, presence=0.1), sure)
    window = reading.window
    drifting = replace(reading, window=PersonWindow(window.x + 50, window.y, window.side))
    assert quality(reading, sure) > quality(drifting, sure)
    # Where nothing is known of the keypoints, nothing is held against it.
    unsure = ObservedKeypoints(same.positions + 500, np.zeros(17))
    assert quality(reading, unsure) == pytest.approx(quality(reading, None))


@given(
    seed=st.integers(0, 9999), x=st.floats(-60, 60), y=st.floats(-60, 60),
    score=st.floats(0, 1), row=st.integers(0, 16),
)  # fmt: skip
def test_fusing_moves_landmarks_towards_keypoints_that_agree_and_never_past_them(
    readings: list[Reading], seed: int, x: float, y: float, score: float, row: int
) -> None:
    reading = readings[seed % len(readings)]
    before = reading.landmarks
    keypoints = ObservedKeypoints(before.keypoints().positions.copy(), np.full(17, score))
    keypoints.positions[row] += (x, y)
    after = fuse(reading, keypoints).landmarks
    change = after.positions - before.positions
    others = np.setdiff1d(np.arange(33), COCO_ROWS[row])
    assert_allclose(change[others], 0, atol=1e-12)
    size = reading.next_window.side / 2.5
    far = np.hypot(x, y) / size
    wanted = np.array([x, y])
    share = float(change[COCO_ROWS[row]] @ wanted / max(float(wanted @ wanted), 1e-12))
    assert -1e-9 <= share < 1
    if far > AGREES_WITHIN + 1e-9 or score == 0:
        assert_allclose(change, 0, atol=1e-12)
    elif far < AGREES_WITHIN - 1e-9 and score > 0.01 and far > 1e-3:
        assert share > 0
    assert_array_equal(after.visibility, before.visibility)
    assert_array_equal(after.metres, before.metres)


def leaning(angle_deg: float, *unseen: str) -> ObservedKeypoints:
    """A trunk turned clockwise about the middle of the hips, all else at one place."""
    angle = np.deg2rad(angle_deg)
    up, across = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    positions = np.full((17, 2), 100.0)
    for i, name in enumerate(COCO_NAMES):
        side = 8 * (1 if name.startswith("left") else -1)
        if name.endswith("hip"):
            positions[i] += side * across
        if name.endswith("shoulder"):
            positions[i] += 40 * up + side * across
    scores = np.array([0.01 if name in unseen else 0.8 for name in COCO_NAMES])
    return ObservedKeypoints(positions, scores)


@given(angle=st.floats(-179, 179))
def test_the_roll_is_how_far_the_trunk_is_turned(angle: float) -> None:
    assert trunk_roll_deg(leaning(angle)) == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("part", ["hip", "shoulder"])
def test_where_an_end_of_the_trunk_is_not_seen_nothing_is_told(part: str) -> None:
    assert trunk_roll_deg(leaning(90, f"left_{part}", f"right_{part}")) is None
    assert trunk_roll_deg(leaning(90, f"left_{part}")) is not None
    assert trunk_roll_deg(None) is None


def test_distinct_bodies_are_kept_and_the_first_of_one_body(readings: list[Reading]) -> None:
    assert distinct_bodies(readings) == [0, 1, 2]
    assert distinct_bodies([]) == []
    again = [readings[0], moved(readings[0], 1, 1), readings[1], readings[0]]
    assert distinct_bodies(again) == [0, 2]


@given(share=st.floats(0, 1), angle=st.floats(-3.14, 3.14))
def test_a_body_is_another_from_a_distance(
    readings: list[Reading], share: float, angle: float
) -> None:
    size = readings[1].next_window.side / 2.5
    x, y = share * size * np.cos(angle), share * size * np.sin(angle)
    kept = distinct_bodies([readings[1], moved(readings[1], x, y)])
    if abs(share - DUPLICATE_BODY_DISTANCE) > 1e-6:
        assert kept == ([0, 1] if share > DUPLICATE_BODY_DISTANCE else [0])


def test_who_is_cut_off_is_read_as_a_part_of_a_whole_body(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Without head and shoulders in the picture, the legs stay where they are."""
    walker = walkers[1]
    whole = person_reader.read(street, walker).landmarks
    top = round(walker.y + 0.35 * walker.height)
    box = Box(walker.x, -0.5, walker.width, walker.bottom - top)
    reading = person_reader.read(street[top:].copy(), box)
    landmarks = attenuate_visibility_at_border(reading, street[top:].shape)
    legs = [i for i, name in enumerate(LANDMARK_NAMES) if name.endswith(("knee", "ankle"))]
    apart = landmarks.positions[legs] + [0, top] - whole.positions[legs]
    assert np.linalg.norm(apart, axis=1).max() < 0.1 * walker.height
    assert landmarks.visibility[legs].min() > 0.5
    head = [i for i, name in enumerate(LANDMARK_NAMES) if "eye" in name or name == "nose"]
    assert landmarks.visibility[head].max() < 0.5


def test_the_window_of_who_is_seen_whole_is_not_extended(walkers: list[Box]) -> None:
    seen = ObservedKeypoints(np.full((17, 2), 50.0), np.ones(17))
    at_border = Box(-0.5, -0.5, 50, 100)
    assert window_beyond_border(seen, at_border, (200, 200, 3)) == []
    assert window_beyond_border(None, at_border, (200, 200, 3)) == []
    assert window_beyond_border(seen, Box(60, 60, 40, 80), (200, 200, 3)) == []
