"""Which finds are one person."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import WINDOW_SCALE, Box, PersonWindow
from app.vision.people import Detection, Landmarks
from app.vision.same_person import (
    KnownPerson,
    first_of_body,
    may_be_reached,
    same_probabilities,
    shows,
    tell_apart,
)
from tests.app.painted import BLANK_PASS, detected, painted

BODY_PX = 80.0
Array = NDArray[np.float64]


def reading(x: float, y: float = 0.0) -> PoseReading:
    """A reading of a body whose middle is at a point."""
    offsets = np.random.default_rng(0).uniform(-BODY_PX, BODY_PX, (33, 2))
    landmarks = Landmarks(np.add(offsets, [x, y]), np.linspace(0.2, 1, 33), np.zeros((33, 3)))
    window = PersonWindow(x, y, 2 * WINDOW_SCALE * BODY_PX)
    probability = np.zeros((LANDMARK_PX, LANDMARK_PX), np.float32)
    return PoseReading(window, landmarks, 1.0, window, BLANK_PASS, probability)


@given(share=st.floats(0, 1), angle=st.floats(-3.14, 3.14))
def test_distant_bodies_are_distinct(share: float, angle: float) -> None:
    apart_px = share * BODY_PX
    other = reading(apart_px * np.cos(angle), apart_px * np.sin(angle))
    first = first_of_body([reading(0), other])
    if share != pytest.approx(0.12):
        assert first == [0, int(share > 0.12)]


def test_boxes_tell_people_apart_and_keypoints_bodies_in_one_place() -> None:
    box, nearly, beside = Box(40, 30, 60, 160), Box(43, 30, 60, 160), Box(60, 30, 60, 160)
    body = detected(painted(box), box)
    for other, people, others in (
        (Detection(nearly, 0.5), 1, 1),  # Nothing shows that it is the same body.
        (detected(painted(box), nearly, 0.5), 1, 0),
        (detected(painted(beside), nearly, 0.5), 1, 1),
        (Detection(Box(200, 30, 60, 160), 0.5), 2, 0),
    ):
        assert tuple(map(len, tell_apart([body, other]))) == (people, others)


@pytest.mark.parametrize(
    ("box", "reached"),
    [
        (Box(100, 50, 40, 100), True),  # Where they are expected,
        (Box(50, 110, 90, 40), True),  # on the ground at either side,
        (Box(100, 110, 90, 40), True),
        (Box(105, 140, 60, 35), True),  # or before the feet;
        (Box(15, 110, 60, 40), False),  # not farther away,
        (Box(165, 110, 60, 40), False),
        (Box(105, 170, 40, 35), False),
        (Box(100, 0, 40, 80), False),  # or above.
    ],
)
def test_a_person_is_expected_where_they_stood_and_on_the_ground_nearby(
    box: Box, reached: bool
) -> None:
    assert may_be_reached(box, Box(100, 50, 40, 100)) == reached


def test_another_detector_shows_a_person_by_the_window_if_it_has_one() -> None:
    person = Detection(Box(100, 50, 40, 100), 0.5)
    side = PersonWindow.about_box(person.box).side
    elsewhere = Box(300, 50, 40, 100)
    for x, y, size, is_shown in (
        (120, 100, 1, True), (101, 51, 1, True), (99, 100, 1, False), (120, 151, 1, False),
        (120, 100, 0.41, True), (120, 100, 0.39, False), (120, 100, 2.4, True),
        (120, 100, 2.6, False),
    ):  # fmt: skip
        found = Detection(elsewhere, 0.5, windows=(PersonWindow(x, y, size * side),))
        assert shows(found, person) == is_shown
    assert shows(Detection(Box(103, 50, 40, 100), 0.5), person)
    assert not shows(Detection(elsewhere, 0.5), person)


def probabilities(known: KnownPerson, boxes: list[Box], *, in_window: bool = False) -> Array:
    features = [known.features(box, None, in_window=in_window) for box in boxes]
    return same_probabilities(np.array(features))


HERE = Box(100, 50, 40, 100)


def test_the_farther_a_person_is_from_the_known_one_the_less_likely_are_they_the_same() -> None:
    soon, later = (KnownPerson(HERE, HERE, elapsed_s, None) for elapsed_s in (0.2, 1.5))
    away = [replace(HERE, x=100.0 + step) for step in range(0, 161, 20)]
    said = probabilities(soon, away)
    assert (np.diff(said) < 0.01).all() and said[0] > 0.8 and said[-1] < 0.05
    # A person who has had the time to walk may be there.
    assert (probabilities(later, away[4:]) > said[4:]).all()
    assert (probabilities(soon, away, in_window=True) > said).all()


def test_nobody_is_compared_from_far_away_and_a_mirror_changes_nothing() -> None:
    known = KnownPerson(HERE, HERE, 0.2, None)
    assert known.may_be(replace(HERE, x=300.0)) and not known.may_be(replace(HERE, x=700.0))
    left, right = (replace(HERE, x=100.0 + step, width=50) for step in (-45, 35))
    np.testing.assert_allclose(*(probabilities(known, [box]) for box in (left, right)))
