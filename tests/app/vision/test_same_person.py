"""Which finds are one person."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import WINDOW_SCALE, Box, PersonWindow
from app.vision.people import Detection, Landmarks
from app.vision.same_person import (
    KnownPerson,
    first_of_body,
    may_be_reached,
    shows,
    tell_apart,
)
from tests.app.painted import detected, painted

BODY_PX = 80.0


def reading(x: float, y: float = 0.0) -> PoseReading:
    """A reading of a body whose middle is at a point."""
    offsets = np.random.default_rng(0).uniform(-BODY_PX, BODY_PX, (33, 2))
    landmarks = Landmarks(np.add(offsets, [x, y]), np.linspace(0.2, 1, 33), np.zeros((33, 3)))
    window = PersonWindow(x, y, 2 * WINDOW_SCALE * BODY_PX)
    probability = np.zeros((LANDMARK_PX, LANDMARK_PX), np.float32)
    return PoseReading(window, landmarks, 1.0, window, probability)


def test_readings_are_grouped_by_body() -> None:
    assert reading(0).body_px == BODY_PX
    assert first_of_body([]) == []
    assert first_of_body([reading(0), reading(1), reading(200), reading(0)]) == [0, 0, 2, 0]


@given(share=st.floats(0, 1), angle=st.floats(-3.14, 3.14))
def test_distant_bodies_are_distinct(share: float, angle: float) -> None:
    apart_px = share * BODY_PX
    other = reading(apart_px * np.cos(angle), apart_px * np.sin(angle))
    first = first_of_body([reading(0), other])
    if share != pytest.approx(0.12):
        assert first == [0, int(share > 0.12)]


def test_without_keypoints_the_boxes_alone_tell_detections_apart() -> None:
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


def test_the_farther_a_person_is_from_the_known_one_the_less_likely_are_they_the_same() -> None:
    here = Box(100, 50, 40, 100)
    soon, later = (KnownPerson(here, here, elapsed_s, None) for elapsed_s in (0.1, 1.0))
    away = [replace(here, x=100.0 + step) for step in range(0, 41, 4)]
    costs, later_costs = (
        np.array([known.cost(box, None, in_window=False) for box in away])
        for known in (soon, later)
    )
    assert (np.diff(costs) > 0).all() and np.isfinite(costs).all()
    # A person who has had the time to walk may be there.
    assert (later_costs[1:] < costs[1:]).all()
    assert costs[0] == later_costs[0] == pytest.approx(0.18)  # Unknown colours alone.
    beyond = replace(here, x=141.0)
    assert soon.cost(beyond, None, in_window=False) == np.inf
    assert soon.cost(beyond, None, in_window=True) < later.cost(beyond, None, in_window=False)


def test_people_grow_and_shrink_gradually_unless_their_window_shows_them() -> None:
    here = Box(100, 50, 40, 100)
    known = KnownPerson(here, here, 0.1, None)
    heights = (100, 110, 130, 160)
    costs = [known.cost(Box(100, 50, 40, height), None, in_window=False) for height in heights]
    assert (np.diff(costs) > 0).all() and costs[-1] < np.inf
    assert known.cost(Box(100, 50, 40, 180), None, in_window=False) == np.inf
    # Compared with what was expected or with what was last seen, whichever is nearer.
    seen = KnownPerson(here, Box(100, 50, 40, 170), 0.1, None)
    assert seen.cost(Box(100, 50, 40, 180), None, in_window=False) < np.inf
