"""People in front of others: what they cover, and where those behind are expected."""

import pytest

from app.estimation.results import Person
from app.tracking.place import PREDICTED_FOR_S, Place
from app.vision.geometry import Box

BEHIND = Box(100, 100, 40, 100)
SIZE = 480, 640


def seen(box: Box, *, at: float = 1.0) -> Place:
    return Place(Person(box, "detector", 0.9), at)


@pytest.mark.parametrize(
    ("left", "at", "share"),
    [(100, 1.0, 1.0), (110, 1.0, 0.75), (139, 1.0, 0.025), (150, 1.0, 0.0), (100, 0.5, 0.0)],
)
def test_the_share_that_another_person_in_sight_covers(
    left: float, at: float, share: float
) -> None:
    place = seen(BEHIND)
    places = [place, seen(Box(left, 100, 40, 100), at=at)]
    assert place.covered_share(BEHIND, places, 1.0) == pytest.approx(share)


@pytest.mark.parametrize(("left", "hides"), [(100, True), (118, True), (122, False)])
def test_a_person_covered_by_half_is_hidden(left: float, hides: bool) -> None:
    place, other = seen(BEHIND, at=0.5), seen(Box(left, 100, 40, 100))
    assert (place.hidden_box([place, other], SIZE, 1.0) == BEHIND) == hides


def test_a_hidden_person_is_not_expected_for_long_or_beyond_the_frame() -> None:
    late = 0.5 + PREDICTED_FOR_S + 0.1
    place = seen(BEHIND, at=0.5)
    assert place.hidden_box([place, seen(BEHIND, at=late)], SIZE, late) is None
    outside = Box(700, 100, 40, 100)
    gone = seen(outside, at=0.5)
    assert gone.hidden_box([gone, seen(outside)], SIZE, 1.0) is None
