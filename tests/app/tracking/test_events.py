"""Events of a track, from the postures of its frames."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from app.estimation.posture_probability import vote_posture
from app.tracking.events import EventDetector, Reliability
from app.tracking.parameters import DEFAULTS
from app.tracking.results import Event
from index.posture import Posture

FPS = 10
STAYS_DOWN_S = DEFAULTS.events.stays_down_s


def watch(
    parts: Iterable[tuple[Posture, float]],
    fps: float = FPS,
    probability: float = 0.9,
    confidence: float = 1.0,
    rests: bool = False,
) -> list[Event]:
    """Events of a person who is in each posture for some seconds."""
    detector = EventDetector()
    events: list[Event] = []
    frame = 0
    for posture, seconds in parts:
        for _ in range(round(seconds * fps)):
            other: Posture = "bending" if posture != "bending" else "crouching"
            shares = vote_posture([posture, other], [probability, 1 - probability])
            events += detector.update(
                7, frame / fps, shares, Reliability(confidence, confidence), rests=rests
            )
            frame += 1
    return events


def names(events: Iterable[Event]) -> list[tuple[str, str]]:
    return [(event.event, event.state) for event in events]


@pytest.mark.parametrize("fps", [5, 10, 30])
def test_a_fall_is_detected_after_a_while_on_the_ground(fps: float) -> None:
    events = watch([("walking", 3), ("bending", 0.6), ("lying", 5)], fps)
    assert names(events) == [("lying", "begin"), ("fell", "instant")]
    lying, fell = events
    assert 3.6 < lying.timestamp < 4.5
    assert lying.timestamp + STAYS_DOWN_S <= fell.timestamp < lying.timestamp + STAYS_DOWN_S + 0.3
    assert all(event.track_id == 7 and 0.5 <= event.probability <= 1 for event in events)


UP_AGAIN = [("standing", 2.0), ("lying", 4.0), ("kneeling", 1.0), ("standing", 3.0)]
FELL = [("lying", "begin"), ("fell", "instant")]
LAY = [("lying", "begin")]
RAISED = [("arms_raised", "begin"), ("arms_raised", "end")]


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([*UP_AGAIN, *UP_AGAIN], 2 * [*FELL, ("lying", "end")]),
        # Slowly, never seen upright, up again at once.
        ([("standing", 3), ("sitting", 6), ("lying", 5)], LAY),
        ([("lying", 8)], LAY),
        ([("standing", 3), ("lying", 1), ("standing", 3)], [*LAY, ("lying", "end")]),
        # Down, but not flat.
        ([("walking", 3), ("crawling", 4)], [("fell", "instant")]),
        # A single frame neither begins nor ends anything.
        ([("standing", 2), ("lying", 1 / FPS), ("standing", 2)], []),
        ([("standing", 2), ("arms_raised", 1 / FPS), ("standing", 2)], []),
        ([("standing", 2), ("lying", 3), ("standing", 1 / FPS), ("lying", 3)], FELL),
        ([("walking", 2), ("arms_raised", 2), ("walking", 2)], RAISED),
    ],
)
def test_events_of_postures(
    parts: list[tuple[Posture, float]], expected: list[tuple[str, str]]
) -> None:
    assert names(watch(parts)) == expected


@pytest.mark.parametrize("posture", ["lying", "arms_raised"])
def test_a_single_frame_begins_nothing_even_at_a_frame_every_five_seconds(posture: Posture) -> None:
    assert watch([("standing", 20), (posture, 5), ("standing", 20)], fps=0.2) == []


def test_raised_arms_begin_and_end_within_a_second() -> None:
    begin, end = watch([("walking", 2), ("arms_raised", 2), ("walking", 2)])
    assert 2.2 < begin.timestamp < 3 and 4.2 < end.timestamp < 5.2


def test_doubtful_postures_and_unreliable_frames_make_no_event() -> None:
    assert watch([("standing", 2), ("lying", 5)], probability=0.4) == []
    assert watch([("standing", 2), ("lying", 2)], confidence=0.05) == []


def test_a_drop_to_half_the_height_is_a_fall_whatever_the_posture() -> None:
    detector, events = EventDetector(), []
    for frame in range(60):
        shares = vote_posture(["standing" if frame < 20 else "bending"], [1.0])
        height_px = 200.0 if frame < 20 else 100.0
        events += detector.update(7, frame / FPS, shares, Reliability(1.0, 1.0), height_px)
    assert names(events) == [("fell", "instant")]


def test_in_a_zone_for_resting_lying_is_no_event() -> None:
    parts: list[tuple[Posture, float]] = [("walking", 3), ("lying", 9), ("crawling", 3)]
    assert names(watch(parts, rests=True)) == []
    raised = watch([("standing", 2), ("arms_raised", 2)], rests=True)
    assert names(raised) == [("arms_raised", "begin")]


def test_lying_begins_when_a_person_leaves_the_zone_for_resting() -> None:
    detector, events = EventDetector(), []
    for frame in range(100):
        lying = vote_posture(["lying", "bending"], [0.9, 0.1])
        events += detector.update(7, frame / FPS, lying, Reliability(1.0, 1.0), rests=frame < 50)
    assert names(events) == [("lying", "begin")]
    assert 5.2 < events[0].timestamp < 6
