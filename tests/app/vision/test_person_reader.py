"""Reading one person: the right one of several windows, fused with MoveNet's keypoints."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.vision.blazepose import PoseReading
from app.vision.geometry import WINDOW_SCALE, Box, PersonWindow
from app.vision.judgement import JudgedReading
from app.vision.optics import PinholeCamera
from app.vision.people import (
    COCO_LANDMARKS,
    COCO_NAMES,
    LANDMARK_NAMES,
    Detection,
    ObservedKeypoints,
    coco_rows,
)
from app.vision.person_reader import (
    AGREEMENT_DISTANCE,
    PersonReader,
    Seen,
    agreement,
    fuse,
    trunk_roll_deg,
    window_beyond_border,
    without_bodies,
)
from app.vision.truncation import attenuate_visibility_at_border
from index.skeleton import other_side
from tests.app.painted import Believing, keypoints_on, painted


def read(
    reader: PersonReader,
    frame: NDArray[np.uint8],
    box: Box,
    *windows: PersonWindow,
    keypoints: ObservedKeypoints | None = None,
    expected: PersonWindow | JudgedReading | None = None,
) -> JudgedReading:
    found = Detection(box, 1.0, keypoints, windows)
    return reader.read(frame, PinholeCamera.of_frame(frame.shape), found, expected)


@pytest.fixture(scope="module")
def readings(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> list[JudgedReading]:
    return [read(person_reader, street, box) for box in walkers]


def test_right_one_of_several_windows_is_chosen(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Not that of asphalt, of a neighbour, or of the person upside down."""
    height = walkers[2].height
    expected = read(person_reader, street, walkers[2])
    assert expected.trust.is_right
    for wrong in ((Box(100, 200, 30, 80),), (walkers[0],), (walkers[2], 180.0)):
        found = read(person_reader, street, walkers[2], PersonWindow.about_box(*wrong))
        apart = found.landmarks.positions - expected.landmarks.positions
        assert np.linalg.norm(apart, axis=1).mean() < 0.05 * height


def test_good_reading_in_the_window_of_a_track_suffices(
    person_reader: PersonReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
    readings: list[JudgedReading],
) -> None:
    box, reading, neighbour = walkers[2], readings[2], readings[0]
    again = read(person_reader, street, box, keypoints=reading.keypoints, expected=reading.window)
    assert again.window == reading.window
    assert_allclose(again.landmarks.positions, reading.landmarks.positions)
    found = read(person_reader, street, box, keypoints=reading.keypoints, expected=neighbour)
    assert_allclose(found.landmarks.positions, reading.landmarks.positions)


def test_a_person_is_followed_as_long_as_the_window_shows_them(
    person_reader: PersonReader, street: NDArray[np.uint8], readings: list[JudgedReading]
) -> None:
    camera = PinholeCamera.of_frame(street.shape)
    for reading in readings:
        known = Detection(reading.landmarks.box(), 1.0)
        window = reading.next_window
        followed = person_reader.follow(street, camera, known, window, 0.0)
        assert followed is not None and followed.keypoints is not None
        apart = followed.landmarks.positions - reading.landmarks.positions
        assert np.linalg.norm(apart, axis=1).mean() < 0.1 * reading.body_px
        if (seen := Seen.of(followed)) is not None:
            # Keypoints move along with their landmarks.
            later = person_reader.follow(street, camera, known, window, 0.0, seen)
            assert later is not None
            assert_allclose(later.landmarks.positions, followed.landmarks.positions)
    assert any(Seen.of(reading) for reading in readings)
    empty = np.full_like(street, 127)
    assert person_reader.follow(empty, camera, known, window, 0.5) is None


def test_where_a_window_is_upside_down_others_are_read_if_they_may(
    person_reader: PersonReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
    readings: list[JudgedReading],
) -> None:
    camera, found = PinholeCamera.of_frame(street.shape), Detection(walkers[2], 1.0)
    window = PersonWindow.about_box(walkers[2], 180.0)
    alone = person_reader.judged(street, camera, window)
    assert not alone.trust.is_right
    seen = person_reader.follow(street, camera, found, window, 0.5)
    assert seen is not None and seen.trust.is_right
    apart = seen.landmarks.positions - readings[2].landmarks.positions
    assert np.linalg.norm(apart, axis=1).mean() < 0.05 * walkers[2].height


def test_agreement_is_the_share_of_keypoints_on_their_landmarks(
    readings: list[JudgedReading],
) -> None:
    reading = readings[2]
    keypoints = keypoints_on(reading)
    assert agreement(reading, keypoints) == pytest.approx(1)
    assert agreement(reading, None) == 0.5
    keypoints.positions[coco_rows("knee", "ankle")] += 2 * AGREEMENT_DISTANCE * reading.body_px
    assert agreement(reading, keypoints) == pytest.approx(9 / 13)


@given(
    seed=st.integers(0, 9999), x=st.floats(-60, 60), y=st.floats(-60, 60),
    score=st.floats(0, 1), row=st.integers(0, 16),
)  # fmt: skip
def test_fusing_moves_landmarks_towards_agreeing_keypoints_only(
    readings: list[JudgedReading], seed: int, x: float, y: float, score: float, row: int
) -> None:
    reading = readings[seed % len(readings)]
    before = reading.landmarks
    keypoints = ObservedKeypoints(before.positions[COCO_LANDMARKS], np.full(17, score))
    keypoints.positions[row] += (x, y)
    after = fuse(reading, keypoints).landmarks
    change = after.positions - before.positions
    others = np.setdiff1d(np.arange(33), COCO_LANDMARKS[row])
    assert_allclose(change[others], 0, atol=1e-12)
    size = reading.next_window.side / 2.5
    far = np.hypot(x, y) / size
    wanted = np.array([x, y])
    share = float(change[COCO_LANDMARKS[row]] @ wanted / max(float(wanted @ wanted), 1e-12))
    assert -1e-9 <= share < 1
    if far > AGREEMENT_DISTANCE + 1e-9 or score == 0:
        assert_allclose(change, 0, atol=1e-12)
    elif far < AGREEMENT_DISTANCE - 1e-9 and score > 0.01 and far > 1e-3:
        assert share > 0
    assert_array_equal(after.visibility, before.visibility)
    assert_array_equal(after.metres, before.metres)


def leaning(angle_deg: float, *unseen: str) -> ObservedKeypoints:
    """A trunk rotated clockwise about the middle of the hips, everything else in one place."""
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
def test_roll_is_the_rotation_of_the_trunk(angle: float) -> None:
    assert trunk_roll_deg(leaning(angle)) == pytest.approx(angle, abs=1e-6)


def test_cut_off_person_is_read_as_part_of_a_whole_body(
    person_reader: PersonReader, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Without head and shoulders in the frame, the legs stay in place."""
    walker = walkers[1]
    whole = read(person_reader, street, walker).landmarks
    top = round(walker.y + 0.35 * walker.height)
    box = Box(walker.x, -0.5, walker.width, walker.bottom - top)
    reading = read(person_reader, street[top:].copy(), box)
    landmarks = attenuate_visibility_at_border(reading, street[top:].shape)
    legs = [i for i, name in enumerate(LANDMARK_NAMES) if name.endswith(("knee", "ankle"))]
    apart = landmarks.positions[legs] + [0, top] - whole.positions[legs]
    assert np.linalg.norm(apart, axis=1).max() < 0.1 * walker.height
    assert landmarks.visibility[legs].min() > 0.5
    head = [i for i, name in enumerate(LANDMARK_NAMES) if "eye" in name or name == "nose"]
    assert landmarks.visibility[head].max() < 0.5


@pytest.mark.parametrize(("unseen", "radius"), [("ankle", 1.7 * 50), ("nose", 80)])
def test_window_reaches_beyond_the_border_to_the_unseen_end(unseen: str, radius: float) -> None:
    """From the hips: as far as the trunk suggests, or as far as the feet on the other side."""
    heights = {"nose": 20, "shoulder": 40, "hip": 90, "ankle": 170}
    positions, scores = np.full((17, 2), 60.0), np.full(17, 0.9)
    for part, y in heights.items():
        positions[coco_rows(part), 1] = y
    scores[coco_rows(unseen)] = 0
    (window,) = window_beyond_border(
        ObservedKeypoints(positions, scores), Box(40, -0.5, 40, 180), (180, 200, 3)
    )
    assert (window.x, window.y, window.roll_deg) == (60, 90, 0)
    assert window.side == pytest.approx(2 * WINDOW_SCALE * radius)


def test_bodies_of_others_are_grey_about_a_person(
    readings: list[JudgedReading], street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    own, other = readings[1].keypoints, readings[2].keypoints
    assert own is not None and other is not None
    before = street.copy()
    painted = without_bodies(street, walkers[1], own, [readings[2]])
    assert_array_equal(street, before)
    grey = (painted == 127).all(axis=2)
    assert_array_equal(painted[~grey], street[~grey])

    def grey_share(keypoints: ObservedKeypoints) -> float:
        columns, rows = keypoints.positions[keypoints.scores > 0.3].round().astype(int).T
        return float(grey[rows, columns].mean())

    assert grey_share(other) > 0.9 and grey_share(own) == 0
    same_place = without_bodies(street, walkers[2], other, [readings[2]])
    assert (same_place == 127).all(axis=2).sum() < grey.sum()


class Sees:
    """A landmark network and MoveNet in one: a reading for each window, the same keypoints."""

    def __init__(
        self, readings: dict[PersonWindow, PoseReading], other: PoseReading, at: ObservedKeypoints
    ) -> None:
        self.readings, self.other, self.keypoints = readings, other, at

    def read(self, frame: NDArray[np.uint8], where: PersonWindow | Box) -> Any:
        if isinstance(where, Box):
            return self.keypoints
        return self.readings.get(where, self.other)


def test_exchanged_sides_are_noticed_at_once_and_read_again() -> None:
    right = painted(Box(20, 20, 250, 500), width=0.5)
    swap = [LANDMARK_NAMES.index(other_side(name)) for name in LANDMARK_NAMES]
    marks = right.landmarks
    exchanged = replace(right, landmarks=replace(marks, positions=marks.positions[swap]))
    keypoints = keypoints_on(right)
    networks: Any = Sees({right.window: exchanged}, right, keypoints)
    reader = PersonReader(networks, networks, networks, Believing())  # type: ignore[arg-type]
    frame = np.zeros((9, 9, 3), np.uint8)
    camera, known = PinholeCamera.of_frame(frame.shape), Detection(Box(20, 20, 250, 500), 1.0)
    # MoveNet looks now, or saw the other sides a frame ago.
    for seen in (None, Seen(np.zeros((17, 2)), keypoints)):
        found = reader.follow(frame, camera, known, right.window, 0.0, seen)
        assert found is not None
        assert_allclose(found.landmarks.positions, right.landmarks.positions)
