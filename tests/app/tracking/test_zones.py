"""Zones: which of them a person is in, by which part of the body."""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.configuration import ZoneKind, has_area
from app.tracking.results import Event
from app.tracking.zones import (
    STAYS_FROM_S,
    Zone,
    ZoneWatch,
    contains,
    crosses_itself,
    distance,
    place,
)
from app.vision.geometry import Box
from index.posture import ON_THE_GROUND, POSTURES, PostureName

SQUARE = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]])
# An L: the upper right quarter of the square is missing.
ELL = np.array([[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [50.0, 30.0], [50.0, 50.0], [10.0, 50.0]])


def zone(name: str, left: float, right: float, kind: ZoneKind = "watch") -> Zone:
    return Zone(name, kind, np.array([[left, 0.0], [right, 0.0], [right, 90.0], [left, 90.0]]))


@given(
    turn=st.floats(0, 6.3),
    shift=st.floats(-1e4, 1e4),
    along=st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=9),
)
def test_corners_on_a_line_have_no_area(turn: float, shift: float, along: list[float]) -> None:
    direction = np.array([np.cos(turn), np.sin(turn)])
    assert not has_area(shift + np.outer(along, direction))


@pytest.mark.parametrize("polygon", [SQUARE, ELL, SQUARE[[0, 2, 1, 3]], SQUARE / 10])
def test_polygons_have_an_area_even_if_they_cross_themselves(polygon: NDArray[np.float64]) -> None:
    assert has_area(polygon)


@given(turn=st.floats(0, 6.3), shift=st.floats(-1e3, 1e3), first=st.integers(0, 5))
def test_only_polygons_whose_border_crosses_itself_are_said_to(
    turn: float, shift: float, first: int
) -> None:
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    for polygon, crosses in ((SQUARE, False), (ELL, False), (SQUARE[[0, 2, 1, 3]], True)):
        assert crosses_itself(np.roll(polygon @ turned + shift, first, axis=0)) == crosses


@given(x=st.floats(0, 60), y=st.floats(0, 60))
def test_a_square_contains_the_points_between_its_sides(x: float, y: float) -> None:
    if 10 not in (x, y) and 50 not in (x, y):
        assert contains(SQUARE, np.array([x, y])) == (10 < x < 50 and 10 < y < 50)


@pytest.mark.parametrize(("point", "inside"), [((20, 20), 1), ((40, 20), 0), ((40, 40), 1)])
def test_polygons_may_have_inward_corners(point: tuple[float, float], inside: int) -> None:
    assert contains(ELL, np.array(point)) == bool(inside)


@given(split=st.floats(11, 49), y=st.floats(11, 49), x=st.floats(11, 49))
def test_of_two_halves_a_point_is_in_exactly_one(split: float, x: float, y: float) -> None:
    left, right = SQUARE.copy(), SQUARE.copy()
    left[[1, 2], 0] = right[[0, 3], 0] = split
    for point in (np.array([x, y]), np.array([split, y])):
        assert contains(left, point) + contains(right, point) == 1


@pytest.mark.parametrize("posture", [*POSTURES, None])
def test_people_are_where_their_feet_are_or_on_the_ground_their_centre(
    posture: PostureName | None,
) -> None:
    box = Box(10.0, 20.0, 30.0, 60.0)
    lies = posture in ON_THE_GROUND
    assert place(box, posture).tolist() == [25.0, 50.0 if lies else 80.0]


def test_zones_come_in_the_order_given() -> None:
    zones = [zone("b", 0, 40), zone("a", 20, 80), zone("c", 60, 90)]
    watch = ZoneWatch()
    watch.locate(zones, Box(20.0, 10.0, 20.0, 50.0), "standing")
    assert [one.name for one in watch.zones] == ["b", "a"]
    watch.locate((), Box(0.0, 0.0, 9.0, 9.0), None)
    assert watch.zones == ()


@pytest.mark.parametrize("shape", [(2, 2), (4, 3), (8,)])
def test_wrong_shapes_of_polygons_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected a polygon"):
        Zone("bed", "rest", np.zeros(shape))


@given(x=st.floats(-20, 80), y=st.floats(-20, 80))
def test_distance_is_that_to_the_nearest_side(x: float, y: float) -> None:
    point = np.array([x, y])
    along = np.linspace(SQUARE, np.roll(SQUARE, -1, axis=0), 401).reshape(-1, 2)
    nearest = np.hypot(*(along - point).T).min()
    assert distance(SQUARE, point) == pytest.approx(nearest, abs=0.06)


FPS = 10
GATE = zone("gate", 0, 100)
"""Its border is at 100 px; a person is 100 px tall, so the margin reaches to 110 px."""


def walk(feet_px: Iterable[float], fps: float = FPS) -> list[Event]:
    watch, events = ZoneWatch(), []
    for number, x in enumerate(feet_px):
        events += watch.update(number / fps, [GATE], Box(x - 20, -20, 40, 100), "walking")
    return events


def crossings(events: Iterable[Event]) -> list[tuple[str, float, float | None]]:
    return [(event.event, event.timestamp, event.dwell_s) for event in events]


def test_a_stay_begins_and_ends_with_its_length() -> None:
    events = walk([150] * 10 + [50] * 30 + [150] * 10)
    assert crossings(events) == [
        ("zone_entered", 1.5, None),
        ("zone_left", 4.5, pytest.approx(3.0)),
    ]
    assert {(event.state, event.zones) for event in events} == {("instant", ("gate",))}


@pytest.mark.parametrize("fps", [1, 5, 10, 30])
@given(jitter=st.lists(st.floats(-9, 9), min_size=60, max_size=60))
def test_at_the_border_nothing_alternates(fps: float, jitter: list[float]) -> None:
    names = [event.event for event in walk([100 + x for x in jitter], fps)]
    assert names in ([], ["zone_entered"])


@given(jitter=st.lists(st.tuples(st.floats(-9, 9), st.booleans()), min_size=60, max_size=60))
def test_a_sleeper_at_the_border_of_two_zones_stays(jitter: list[tuple[float, bool]]) -> None:
    """Also while the posture is unclear: the feet would be outside of both."""
    watch, events = ZoneWatch(), []
    halves = zone("bed", 0, 100, "rest"), zone("sofa", 100, 200)
    for number, (x, is_clear) in enumerate([(-20.0, True)] * 9 + jitter):
        posture: PostureName | None = "lying" if is_clear else None
        events += watch.update(number / FPS, halves, Box(50 + x, 70, 100, 30), posture)
        assert halves[0] in watch.zones
    assert [event.event for event in events] in (["zone_entered"], ["zone_entered"] * 2)


@given(feet_px=st.lists(st.sampled_from([50.0, 105.0, 150.0]), max_size=60))
def test_a_person_enters_and_leaves_in_turn(feet_px: list[float]) -> None:
    names = [event.event for event in walk(feet_px)]
    assert names == ["zone_entered", "zone_left"] * (len(names) // 2) + ["zone_entered"] * (
        len(names) % 2
    )
    assert all(event.dwell_s is None or event.dwell_s >= 0 for event in walk(feet_px))


@pytest.mark.parametrize(("here", "there"), [(50, 150), (150, 50)])
def test_a_moment_on_the_other_side_is_no_event(here: float, there: float) -> None:
    moment = round(STAYS_FROM_S * FPS) - 1
    assert len(walk([here] * 20 + [there] * moment + [here] * 20)) == (here == 50)


def test_zones_are_left_where_the_track_ends_or_the_camera_loses_them() -> None:
    box = Box(30, -20, 40, 100)
    for ends in (False, True):
        watch = ZoneWatch()
        for number in range(11):
            watch.update(number / FPS, [GATE], box, None)
        events = watch.end(3.0, 1.0) if ends else watch.update(3.0, [], box, None)
        assert crossings(events) == [("zone_left", 3.0, 1.0 if ends else 3.0)]
        assert watch.end(4.0, 4.0) == []


def test_every_zone_that_is_taken_away_is_left() -> None:
    watch, box = ZoneWatch(), Box(30, -20, 40, 100)
    for number in range(11):
        watch.update(number / FPS, [GATE, zone("door", 0, 90)], box, None)
    left = watch.update(2.0, [], box, None)
    assert [event.zones for event in left] == [("door",), ("gate",)]
