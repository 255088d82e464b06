"""Events of a track, from the postures of its frames."""

from collections.abc import Iterable

import pytest

from app.estimation.posture import vote_posture
from app.tracking.events import (
    STAYS_DOWN_S,
    STAYS_LOW_S,
    DropDetector,
    EventDetector,
    HipHeight,
    Reliability,
)
from app.tracking.results import Event
from app.vision.geometry import Box
from index.posture import PostureName

FPS = 10
PX_PER_M = 100.0
HIPS_M: dict[PostureName, float] = {
    "lying": 0.15, "crawling": 0.4, "kneeling": 0.5, "sitting": 0.5, "bending": 0.9
}  # fmt: skip
"""Height of the hips over the ground; 0.95 m where not named."""


def hips_at(height_m: float) -> HipHeight:
    return HipHeight(500.0 - PX_PER_M * height_m, PX_PER_M)


def watch(
    parts: Iterable[tuple[PostureName, float]],
    fps: float = FPS,
    probability: float = 0.9,
    confidence: float = 1.0,
    rests: bool = False,
    hips_m: dict[PostureName, float] = HIPS_M,
    detector: EventDetector | None = None,
) -> list[Event]:
    """Events of a person who is in each posture for some seconds."""
    detector = detector or EventDetector()
    events: list[Event] = []
    frame = 0
    for posture, seconds in parts:
        for _ in range(round(seconds * fps)):
            other: PostureName = "bending" if posture != "bending" else "crouching"
            shares = vote_posture([posture, other], [probability, 1 - probability])
            events += detector.update(
                7,
                frame / fps,
                shares,
                Reliability(confidence, confidence),
                hips_at(hips_m.get(posture, 0.95)),
                posture=posture,
                rests=rests,
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
    assert lying.timestamp <= fell.timestamp < lying.timestamp + STAYS_DOWN_S + 0.3
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
        ([("standing", 3), ("lying", 0.5), ("standing", 3)], [*LAY, ("lying", "end")]),
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
    parts: list[tuple[PostureName, float]], expected: list[tuple[str, str]]
) -> None:
    assert names(watch(parts)) == expected


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        # Too short on the ground for anything to be certain.
        ([("walking", 3), ("lying", 0.3)], ["lying", "fell"]),
        ([("walking", 3), ("arms_raised", 0.2)], ["arms_raised"]),
        ([("walking", 3), ("lying", 3)], []),
        ([("walking", 3), ("bending", 1)], []),
        ([("walking", 3), ("lying", 0.3), ("walking", 3)], []),
    ],
)
def test_what_has_begun_to_show_at_the_end_is_unconfirmed(
    parts: list[tuple[PostureName, float]], expected: list[str]
) -> None:
    detector = EventDetector()
    watch(parts, detector=detector)
    found = detector.unconfirmed(7)
    assert names(found) == [(name, "unconfirmed") for name in expected]
    end = sum(seconds for _, seconds in parts) - 1 / FPS
    assert all(one.timestamp == pytest.approx(end) and one.probability < 0.5 for one in found)


@pytest.mark.parametrize("posture", ["lying", "arms_raised"])
def test_a_single_frame_begins_nothing_even_at_a_frame_every_five_seconds(
    posture: PostureName,
) -> None:
    assert watch([("standing", 20), (posture, 5), ("standing", 20)], fps=0.2) == []


def test_raised_arms_begin_and_end_within_a_second() -> None:
    begin, end = watch([("walking", 2), ("arms_raised", 2), ("walking", 2)])
    assert 2.2 < begin.timestamp < 3 and 4.2 < end.timestamp < 5.2


def test_doubtful_postures_and_unreliable_frames_make_no_event() -> None:
    assert watch([("standing", 2), ("lying", 5)], probability=0.2) == []
    assert watch([("standing", 2), ("lying", 5)], probability=0.4, hips_m={}) == []
    assert watch([("standing", 2), ("lying", 2)], confidence=0.05) == []


def drops(heights_m: Iterable[float], fps: float = FPS) -> list[bool]:
    detector, found = DropDetector(), []
    for frame, height_m in enumerate(heights_m):
        detector.update(frame / fps, hips_at(height_m))
        found.append(detector.dropped_at is not None)
    return found


@pytest.mark.parametrize("fps", [2, 5, 10, 30])
def test_drop_is_fast_and_far(fps: int) -> None:
    def fall(metres: float, seconds: float) -> list[float]:
        steps = [0.95 - metres * min(1.0, k / (seconds * fps)) for k in range(round(4 * fps))]
        return fps * [0.95] + steps

    assert drops(fall(0.6, 0.8), fps)[-1]
    assert not any(drops(fall(0.3, 0.8), fps))
    assert not any(drops(fall(0.6, 4.0), fps))


def test_hips_that_come_up_again_have_not_dropped() -> None:
    assert not drops([*[0.95] * 10, 0.7, 0.5, 0.5, 0.8, *[0.95] * 20])[-1]


def test_drop_after_an_earlier_one_counts_anew() -> None:
    detector = DropDetector()
    for frame, height_m in enumerate([*[1.4] * 5, *[0.95] * 50, *[0.1] * 5]):
        detector.update(frame / FPS, hips_at(height_m))
    assert detector.dropped_at == 5.5


def test_fall_out_of_bed_is_a_fall_although_the_person_was_lying_before() -> None:
    detector, events = EventDetector(), []
    lying = vote_posture(["lying"], [1.0])
    for frame in range(60):
        height_m = 0.6 if frame < 30 else max(0.1, 0.6 - 0.1 * (frame - 30))
        events += detector.update(
            7, frame / FPS, lying, Reliability(1.0, 1.0), hips_at(height_m), posture="lying"
        )
    assert names(events) == [("lying", "begin"), ("fell", "instant")]
    assert 3 < events[1].timestamp < 5


def test_deep_drop_needs_less_certain_postures() -> None:
    for height_m, falls in ((0.5, False), (0.15, True)):
        heights: dict[PostureName, float] = {"lying": height_m}
        events = watch([("standing", 2), ("lying", 3)], probability=0.4, hips_m=heights)
        assert [event.event for event in events] == (["fell"] if falls else [])


def test_lying_down_slowly_is_no_fall() -> None:
    slowly: list[tuple[PostureName, float]] = [("sitting", 2), ("bending", 1), ("lying", 5)]
    heights: dict[PostureName, float] = {"sitting": 0.6, "bending": 0.55, "lying": 0.5}
    assert names(watch(slowly, hips_m=heights)) == LAY


def test_bending_and_sitting_down_are_no_falls() -> None:
    assert watch([("standing", 2), ("bending", 4)]) == []
    assert watch([("standing", 2), ("sitting", 4)]) == []


def test_heights_seen_from_above_are_foreshortened() -> None:
    assert HipHeight.seen(10.0, 100.0, 0.0).px_per_m == 100.0
    assert HipHeight.seen(10.0, 100.0, 60.0).px_per_m == pytest.approx(50.0)
    assert HipHeight.seen(10.0, 100.0, -90.0).px_per_m == pytest.approx(50.0)


def test_in_a_zone_for_resting_lying_is_no_event() -> None:
    parts: list[tuple[PostureName, float]] = [("walking", 3), ("lying", 9), ("crawling", 3)]
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


FRAME = (480, 640)
STANDS, SAT, DOWN = Box(300, 200, 60, 200), Box(300, 290, 70, 110), Box(280, 340, 120, 70)


def follow(
    boxes: Iterable[tuple[Box, float]],
    posture: PostureName | None = None,
    *,
    rests: bool = False,
    alone: bool = True,
    begins_clear: bool = True,
) -> tuple[list[Event], list[Event]]:
    """Events while a person's box moves, and as they are lost; hips are not seen.

    The posture is that after the first box, whose person stands.
    """
    detector, events, frame = EventDetector(), [], 0
    shares = vote_posture(["bending", "sitting", "lying"], [0.4, 0.3, 0.3])
    for number, (box, seconds) in enumerate(boxes):
        for _ in range(round(seconds * FPS)):
            events += detector.update(
                7,
                frame / FPS,
                shares,
                Reliability(1, 1),
                None,
                box,
                posture=posture if number or not begins_clear else "standing",
                rests=rests,
                alone=alone,
            )
            frame += 1
    return events, [*detector.lost(7, frame / FPS, FRAME)]


def test_a_fall_with_an_unclear_posture_is_seen_by_the_box_once() -> None:
    events, lost = follow([(STANDS, 2), (DOWN, 6)])
    assert names(events) == [("fell", "instant")]
    assert events[0].timestamp == pytest.approx(2 + STAYS_LOW_S, abs=0.3)
    assert not lost


@pytest.mark.parametrize(
    "boxes",
    [
        [(STANDS, 8)],
        [(STANDS, 2), (DOWN, 1.5), (STANDS, 5)],  # Up again.
        [(STANDS, 2), (Box(300, 200, 60, 80), 6)],  # Behind a table.
        [
            (STANDS, 2),
            *((Box(300, 200 + 14 * n, 80, 200 - 13 * n), 1) for n in range(10)),
        ],  # Slowly.
        [(STANDS, 2), (Box(300, 290, 60, 200), 6)],  # Nearer to a high camera.
        [(STANDS, 2), *((Box(280 + 20 * n, 340, 80, 90), 0.2) for n in range(30))],  # Walks on.
    ],
)
def test_other_boxes_are_no_fall(boxes: list[tuple[Box, float]]) -> None:
    assert follow(boxes)[0] == []


def test_a_clear_posture_says_more_than_the_box() -> None:
    assert follow([(STANDS, 2), (DOWN, 6)], "bending")[0] == []
    assert follow([(STANDS, 2), (DOWN, 6)], rests=True) == ([], [])


def test_a_box_beside_others_may_be_a_part_of_somebody() -> None:
    assert follow([(STANDS, 2), (DOWN, 6)], alone=False)[0] == []


def test_nobody_fell_whose_posture_was_never_clear() -> None:
    fall = [(STANDS, 2.0), (SAT, 0.2), (DOWN, 6.0)]
    assert follow(fall, begins_clear=False) == ([], [])
    assert names(follow(fall)[0]) == [("fell", "instant")]


def test_nobody_sits_lower_than_a_seat() -> None:
    assert follow([(STANDS, 2), (SAT, 6)], "sitting")[0] == []
    assert names(follow([(STANDS, 2), (SAT, 1), (DOWN, 6)], "sitting")[0]) == [("fell", "instant")]


TIPPED = (Box(120, 370, 280, 110), 0.2)
LEAVES = [(Box(300, 100 + 30 * n, 120, 380 - 30 * n), 0.1) for n in range(8)]


@pytest.mark.parametrize(
    ("boxes", "falls"),
    [
        ([(STANDS, 2), (SAT, 0.2), (DOWN, 0.2)], True),
        ([(STANDS, 2)], False),
        ([(STANDS, 2), (DOWN, 0.3), (STANDS, 2)], False),
        # Past the left border, and out of the frame below the camera.
        ([(Box(0, 200, 60, 200), 2), (Box(0, 340, 70, 70), 0.3)], False),
        ([(Box(300, 100, 120, 380), 2), *LEAVES], False),
        # At the same border, but lying across, or tipping over.
        ([(Box(300, 100, 120, 380), 2), (Box(280, 420, 170, 60), 0.3)], True),
        ([(Box(300, 180, 120, 300), 2), (Box(200, 300, 200, 180), 0.2), TIPPED], True),
    ],
)
def test_a_person_who_is_lost_while_sinking_fell(
    boxes: list[tuple[Box, float]], falls: bool
) -> None:
    events, lost = follow(boxes)
    assert not events
    assert names(lost) == ([("fell", "instant")] if falls else [])
