"""Events of a track, from the postures of its frames; falls are those of ``test_falls``."""

from collections.abc import Iterable

import numpy as np
import pytest

from app.estimation.posture import LANDMARK_GROUPS
from app.tracking.events import Watches
from app.tracking.falls import observation
from app.tracking.results import Event
from app.tracking.zones import Zone
from app.vision.geometry import Box
from index.posture import PostureName, vote_posture

FPS = 10
FRAME = (480, 640)
BOXES: dict[PostureName, Box] = {
    "lying": Box(240, 290, 190, 65), "crawling": Box(250, 260, 170, 95),
    "sitting": Box(295, 220, 80, 130), "kneeling": Box(295, 220, 80, 130),
}  # fmt: skip
STANDS = Box(300, 150, 70, 200)
BED = Zone("bed", "rest", np.array([[0.0, 0.0], [640, 0], [640, 480], [0, 480]]))


def watch(
    parts: Iterable[tuple[PostureName, float]],
    fps: float = FPS,
    probability: float = 0.9,
    confidence: float = 1.0,
    rests: bool = False,
    watches: Watches | None = None,
) -> list[Event]:
    """Events of a person who is in each posture for some seconds."""
    watches = watches or Watches()
    watches.enter(0.0, [BED] if rests else [], STANDS, 1.0)
    events: list[Event] = []
    frame = 0
    for posture, seconds in parts:
        for _ in range(round(seconds * fps)):
            other: PostureName = "bending" if posture != "bending" else "crouching"
            shares = vote_posture([posture, other], [probability, 1 - probability])
            box = BOXES.get(posture, STANDS)
            seen = observation(box, FRAME, LANDMARK_GROUPS.sums(shares), 0.6 * confidence)
            events += watches.update(frame / fps, shares, confidence, seen)
            frame += 1
    return events


def names(events: Iterable[Event]) -> list[tuple[str, str]]:
    return [(event.event, event.state) for event in events]


@pytest.mark.parametrize("fps", [5, 10, 15])
def test_a_fall_is_detected_after_a_while_on_the_ground(fps: float) -> None:
    events = watch([("walking", 3), ("bending", 0.4), ("lying", 5)], fps)
    assert sorted(names(events)) == [("fell", "instant"), ("lying", "begin")]
    assert all(3.4 < event.timestamp < 5.5 for event in events)
    assert all(0.5 <= event.probability <= 1 for event in events)
    assert not any(event.lost for event in events)


RAISED = [("arms_raised", "begin"), ("arms_raised", "end")]


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([("lying", 8)], [("lying", "begin")]),
        ([("lying", 4), ("standing", 3)], [("lying", "begin"), ("lying", "end")]),
        # A single frame neither begins nor ends anything.
        ([("standing", 2), ("lying", 1 / FPS), ("standing", 2)], []),
        ([("standing", 2), ("arms_raised", 1 / FPS), ("standing", 2)], []),
        ([("lying", 3), ("standing", 1 / FPS), ("lying", 3)], [("lying", "begin")]),
        ([("walking", 2), ("arms_raised", 2), ("walking", 2)], RAISED),
        ([("standing", 2), ("bending", 4)], []),
        ([("standing", 2), ("sitting", 4)], []),
    ],
)
def test_events_of_postures(
    parts: list[tuple[PostureName, float]], expected: list[tuple[str, str]]
) -> None:
    assert names(watch(parts)) == expected


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        # Too short on the ground for anything to be certain.
        ([("walking", 3), ("lying", 0.3)], {"lying"}),
        ([("walking", 3), ("arms_raised", 0.2)], {"arms_raised"}),
        ([("walking", 3), ("bending", 1)], set()),
        ([("walking", 3), ("lying", 0.3), ("walking", 3)], set()),
    ],
)
def test_what_has_begun_to_show_at_the_end_is_unconfirmed(
    parts: list[tuple[PostureName, float]], expected: set[str]
) -> None:
    watches = Watches()
    watch(parts, watches=watches)
    found = watches.unconfirmed()
    assert {one.event for one in found} - {"fell"} == expected
    assert all(one.state == "unconfirmed" for one in found)
    end = sum(seconds for _, seconds in parts) - 1 / FPS
    assert all(one.timestamp == pytest.approx(end) for one in found)


@pytest.mark.parametrize("posture", ["lying", "arms_raised"])
def test_a_single_frame_begins_nothing_even_at_a_frame_every_five_seconds(
    posture: PostureName,
) -> None:
    assert watch([("standing", 20), (posture, 5), ("standing", 20)], fps=0.2) == []


def test_raised_arms_begin_and_end_within_a_second() -> None:
    begin, end = watch([("walking", 2), ("arms_raised", 2), ("walking", 2)])
    assert 2.2 < begin.timestamp < 3 and 4.2 < end.timestamp < 5.2


def test_doubtful_postures_and_unreliable_frames_begin_nothing() -> None:
    assert watch([("lying", 5)], probability=0.2) == []
    assert watch([("lying", 2)], confidence=0.05) == []


def test_in_a_zone_for_resting_lying_is_no_event() -> None:
    parts: list[tuple[PostureName, float]] = [("walking", 3), ("lying", 9), ("crawling", 3)]
    assert names(watch(parts, rests=True)) == []
    raised = watch([("standing", 2), ("arms_raised", 2)], rests=True)
    assert names(raised) == [("arms_raised", "begin")]


@pytest.mark.parametrize("rests", [False, True])
def test_who_is_lost_in_a_zone_for_resting_did_not_fall(rests: bool) -> None:
    """Elsewhere, the same person fell."""
    watches = Watches()
    assert not watch([("walking", 3), ("lying", 0.3)], rests=rests, watches=watches)
    lost = watches.lost(3.3 + 2)
    assert [(one.event, one.lost) for one in lost] == ([] if rests else [("fell", True)])


def test_lying_begins_when_a_person_leaves_the_zone_for_resting() -> None:
    watches = Watches()
    watch([("lying", 5)], rests=True, watches=watches)
    watches.enter(5.0, [], STANDS, 1.0)
    events: list[Event] = []
    for frame in range(50, 100):
        shares = vote_posture(["lying", "bending"], [0.9, 0.1])
        seen = observation(BOXES["lying"], FRAME, LANDMARK_GROUPS.sums(shares), 0.6)
        events += watches.update(frame / FPS, shares, 1.0, seen)
    assert names(events) == [("lying", "begin")]
    assert 5.2 < events[0].timestamp < 6
