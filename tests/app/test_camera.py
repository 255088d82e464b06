"""Camera sessions, on drawn people whom a detector finds by their colour."""

import contextlib
import sys
from collections import deque
from copy import copy
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.camera import TRACK_BYTES, CameraSession, LateFrameError
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import DeadlineError, Job
from app.tracking import actions, falls
from app.tracking.events import Watches
from app.tracking.results import Event, TrackedFrame
from app.vision.geometry import Box
from app.vision.optics import Optics
from tests.app.drawn import COLUMNS, PERSON, ROWS, draw, ids, send
from tests.conftest import png
from tests.golden.pictures import EMPTY_YARD, decode
from tests.support.jobs import ShortJob


def events(result: TrackedFrame) -> list[tuple[str, int]]:
    return [(event.event, event.track_id) for event in result.events]


def test_all_but_poses_is_the_same_whether_or_not_poses_are_wanted(
    estimator: Estimator, street: NDArray[np.uint8]
) -> None:
    """A street of five people before a camera that sways, read by the networks."""
    answers = []
    for n in (0, 7):
        session, seen = CameraSession(estimator), []
        for step in range(4):
            upload = Upload(np.roll(street, 2 * step, axis=1))
            result = session.process(upload, step / 5, n, Job())
            seen += result.events
            for one in result.persons:
                assert (one.pose is None) == (n == 0) and len(one.hypotheses) == n
                assert one.posture is not None
                shares = one.posture.shares.tolist()
                seen += [one.track_id, one.box, shares, one.facing, one.action, one.zones]
        answers.append(seen)
    assert len(answers[0]) > 50
    assert answers[0] == answers[1]


@pytest.mark.parametrize(("place", "left_after_s"), [(2, 0.5), (100, 2.0)])
def test_unseen_track_disappears_then_leaves(
    session: CameraSession, place: int, left_after_s: float
) -> None:
    """At the border soon; within the frame later, since the person may be found again."""
    send(session, 0.0, (0, place))
    assert ids(send(session, 0.1, (0, place))) == [1]
    left = []
    for step in range(2, 26):
        result = send(session, step / 10)
        assert ids(result) == []
        left += [(event.event, event.timestamp) for event in result.events]
    assert left == [("left", pytest.approx(0.1 + left_after_s, abs=0.11))]
    assert session.memory_bytes == 0


def test_a_person_who_vanished_within_the_frame_keeps_the_identity(session: CameraSession) -> None:
    send(session, 0.0, (0, 100))
    for step in range(1, 15):
        assert ids(send(session, step / 10)) == []
    assert ids(send(session, 1.5, (0, 110))) == [1]


@pytest.mark.parametrize(("fps", "speed"), [(1, 64), (5, 0), (30, -64)])
def test_identities_and_poses_at_any_frame_rate(
    session: CameraSession, fps: int, speed: int
) -> None:
    """Standing still, and walking at 1.2 m/s."""
    for frame in range(min(20, 3 * fps + 1)):
        left = round((20 if speed >= 0 else 270) + speed * frame / fps)
        result = send(session, frame / fps, (0, left))
        assert ids(result) == [1]
        pose = result.persons[0].pose
        assert pose is not None
        assert np.isfinite(pose.points_3d).all() and np.isfinite(pose.points_2d).all()


@pytest.mark.parametrize("first", [0.0, 5.0])
@pytest.mark.parametrize("step", [0.0, -1.0, float("nan"), 1e-310, 1e-9, 9e-4])
def test_late_frames_are_refused_and_change_nothing(
    session: CameraSession, first: float, step: float
) -> None:
    send(session, first, (0, 50))
    with pytest.raises(LateFrameError, match=f"after {first:g} s"):
        send(session, first + step, (0, 50))
    second = send(session, first + 1.1e-3, (0, 50))
    assert second.frame_index == 1 and ids(second) == [1]


@pytest.mark.parametrize("jump", [3 * 3600.0, -3 * 3600.0, 12.0, -12.0])
def test_one_wrong_timestamp_costs_two_frames_their_tracks(
    session: CameraSession, jump: float
) -> None:
    """That of the frame itself, and that of the next one."""
    start = 1e5
    for timestamp in (start, start + 0.1):
        assert send(session, timestamp, (0, 50)).reset is None
    for timestamp, ahead in ((start + 0.2 + jump, jump > 0), (start + 0.3, jump < 0)):
        result = send(session, timestamp, (0, 50))
        assert result.reset is not None
        assert ("no frame came for" if ahead else "timestamps went back by") in result.reset
        assert [event.event for event in result.events] == ["left", "entered"]
    assert send(session, start + 0.4, (0, 50)).reset is None


def test_without_timestamps_the_clock_counts(drawn: Estimator) -> None:
    now = iter((100.0, 100.5, 100.5, 103.0))
    session = CameraSession(drawn, clock=lambda: next(now))
    times = [send(session, None).timestamp for _ in range(4)]
    assert times == pytest.approx([0.0, 0.5, 0.501, 3.001])


@pytest.mark.parametrize(
    ("time", "columns", "reason"),
    [(0.1, 300, "320x200 pixels before, this one is 300x200"), (11.0, COLUMNS, "for 11.0 s")],
)
def test_another_size_or_a_long_gap_starts_afresh(
    session: CameraSession, time: float, columns: int, reason: str
) -> None:
    send(session, 0.0, (0, 50))
    result = send(session, time, (0, 50), columns=columns)
    assert result.reset is not None and reason in result.reset
    assert result.session == "warm"
    assert ids(result) == [2]
    assert events(result) == [("left", 1), ("entered", 2)]
    assert send(session, time + 0.1, (0, 50), columns=columns).reset is None


@pytest.mark.parametrize("steps", range(1, 8))
def test_a_frame_that_failed_half_way_may_be_sent_again(session: CameraSession, steps: int) -> None:
    for time in (0.0, 0.1, 0.2):
        send(session, time, (0, 50))
    job = ShortJob(steps - 1)
    with contextlib.suppress(DeadlineError):
        session.process(Upload(draw((0, 52))), 0.3, 3, job)
    again = 0.3 if job.steps < 0 else 0.4
    result = send(session, again, (0, 52))
    assert ids(result) == [1]
    assert result.persons[0].pose is not None
    assert np.isfinite(result.persons[0].pose.points_3d).all()
    assert ids(send(session, again + 0.1, (0, 54))) == [1]


@pytest.mark.parametrize("kind", ["mask", "boxes", "background", "mask alone"])
def test_the_caller_may_say_where_people_are(session: CameraSession, kind: str) -> None:
    results = []
    for step in range(5):
        left = 50 + 5 * step
        labels = np.zeros((ROWS, COLUMNS), np.uint8)
        labels[60 : 60 + PERSON, left : left + 30] = 1
        frame = draw((0, left), seed=step)
        upload = {
            "mask": Upload(frame, mask=png(labels)),
            "boxes": Upload(frame, boxes=(Box(left - 0.5, 59.5, 30, PERSON),)),
            "background": Upload(frame, background=draw(seed=99)),
            "mask alone": Upload(mask=png(labels)),
        }[kind]
        results.append(session.process(upload, step / 10, 3, Job(), "silhouette"))
    assert ids(results[-1]) == [1]
    assert results[-1].persons[0].source == kind.split()[0]
    assert [ids(result) for result in results].count([1]) >= 3


def test_a_person_keeps_the_identity_that_the_caller_gave(session: CameraSession) -> None:
    """Wherever the boxes are: these change places."""
    for step, lefts in enumerate([(50, 200), (200, 50)]):
        boxes = tuple(Box(left - 0.5, 59.5, 30, PERSON) for left in lefts)
        upload = Upload(draw((0, 50), (1, 200)), boxes=boxes, track_ids=("17", "b"))
        result = session.process(upload, step / 10, 3, Job())
        places = {one.caller_track_id: one.box.x for one in result.persons}
        assert places == {"17": lefts[0] - 0.5, "b": lefts[1] - 0.5}
        assert {one.caller_track_id: one.track_id for one in result.persons} == {"17": 1, "b": 2}


def test_a_hidden_person_stays_where_they_are_expected(session: CameraSession) -> None:
    """Another one comes from the right and stops in front of them."""

    def with_boxes(time: float, *lefts: int) -> TrackedFrame:
        boxes = tuple(Box(left - 0.5, 59.5, 30, PERSON) for left in lefts)
        upload = Upload(draw((0, 100), (1, lefts[-1])), boxes=boxes)
        return session.process(upload, time, 3, Job())

    for step in range(8):
        with_boxes(step / 10, 100, 180 - 10 * step)
    hidden = with_boxes(0.8, 105)
    assert [(one.track_id, one.source) for one in hidden.persons] == [
        (1, "track"), (2, "boxes")
    ]  # fmt: skip
    person, pose = hidden.persons[0], hidden.persons[0].pose
    assert person.box.x == pytest.approx(99.5, abs=1) and person.hypotheses == ()
    assert pose is not None
    for step in range(9, 27):
        assert ids(with_boxes(step / 10, 105)) == [1, 2]
    later = with_boxes(2.8, 105)
    assert ids(later) == [2] and events(later) == [("left", 1)]


def test_who_was_hidden_does_not_fall_when_lost(
    session: CameraSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However likely the fall seemed: another one walked in front of them, then on."""
    monkeypatch.setattr(Watches, "lost", lambda *_: [Event("fell", "instant", 0.0, 1.0)])
    for step in range(12):
        left = 180 - 10 * step
        boxes = [Box(left - 0.5, 59.5, 30, PERSON)]
        if left > 120:
            boxes.append(Box(99.5, 59.5, 30, PERSON))
        seen = session.process(Upload(draw((0, left)), boxes=tuple(boxes)), step / 10, 0, Job())
    assert ids(seen) == [1]
    fell = []
    for step in range(12, 40):
        boxes = (Box(69.5, 59.5, 30, PERSON),)
        result = session.process(Upload(draw((0, 70)), boxes=boxes), step / 10, 0, Job())
        fell += [event.event for event in result.events]
    assert "fell" not in fell and "left" in fell


@pytest.mark.parametrize(("left", "falls"), [(122, False), (128, False), (135, True)])
def test_who_is_lost_behind_another_one_did_not_fall(
    session: CameraSession, monkeypatch: pytest.MonkeyPatch, left: int, falls: bool
) -> None:
    """Even if that one covers a few pixels of the place where they were last seen."""
    lost = (Event("fell", "instant", 0.0, 1.0),)
    monkeypatch.setattr(Watches, "lost", lambda *_: lost)
    both = [Box(one - 0.5, 59.5, 30, PERSON) for one in (100, left)]
    told = []
    for step in range(30):
        boxes = tuple(both if step < 5 else both[1:])
        frame = draw((0, 100), (1, left)) if step < 5 else draw((1, left))
        told += session.process(Upload(frame, boxes=boxes), step / 10, 0, Job()).events
    assert [one.event for one in told if one.track_id == 1 and one.event != "entered"] == (
        ["fell", "left"] if falls else ["left"]
    )


def test_another_roll_is_another_view(drawn: Estimator) -> None:
    """The camera was not turned: only what the caller says about it was corrected."""
    session, yard = CameraSession(drawn), decode(EMPTY_YARD)

    def told(begin: int, end: int, picture: NDArray[np.uint8], roll_deg: float) -> list[str]:
        raised = []
        for time in range(begin, end):
            noise = np.random.default_rng(time).integers(0, 3, picture.shape, np.uint8)
            upload = Upload(cv2.add(picture, noise), optics=Optics(roll_deg=roll_deg))
            result = session.process(upload, float(time), 0)
            raised += [f"{one.event} {one.state}" for one in result.events]
            assert ("obstructed" in result.warnings) == (raised[-1:] == ["obstructed begin"])
        return raised

    assert told(0, 20, yard, 0.0) == []
    assert told(20, 40, yard, 180.0) == []
    covered = np.full_like(yard, 90)
    assert told(40, 50, covered, 180.0) == ["obstructed begin"]
    # Of the view that is known now, nothing blocked is known.
    assert told(50, 60, covered, 0.0) == ["obstructed end"]


def test_every_frame_says_whether_people_are_left_out(drawn: Estimator) -> None:
    """Also between two searches; who is followed is not left out."""
    few = copy(drawn)
    few.finder = replace(drawn.finder, max_persons=2)
    session = CameraSession(few)
    for step in range(10):
        result = send(session, step / 10, (0, 20), (1, 120), (2, 220))
        assert (len(result.persons), result.warnings) == (2, ("crowded",))
    for step in range(10, 20):
        result = send(session, step / 10, (0, 20), (1, 120))
    assert (len(result.persons), result.warnings) == (2, ())


def test_the_number_of_tracks_is_bounded(session: CameraSession) -> None:
    rng = np.random.default_rng(0)
    for step in range(12):
        lefts = rng.integers(0, COLUMNS - 30, 3)
        send(session, step / 2, *((colour, int(left)) for colour, left in enumerate(lefts)))
    assert session.memory_bytes // TRACK_BYTES <= 8


def test_a_track_holds_about_as_many_bytes_as_reported(session: CameraSession) -> None:
    send(session, 0.0)  # The pictures of the camera are no part of a track.
    seen: dict[int, object] = {}  # They stay alive, so that no later object has their identity.
    for shared in (session, actions.shipped_model(), *falls.shipped_models()):
        held_bytes(shared, seen)
    for frame in range(32):
        send(session, (1 + frame) / 10, (0, 100))
    held = held_bytes([*vars(session).values(), *vars(session)["_tracks"]], seen)
    assert session.memory_bytes / 2 < held < 2 * session.memory_bytes


def held_bytes(value: object, seen: dict[int, object]) -> int:
    """Bytes of an object and of all that it holds but what was seen before."""
    if id(value) in seen:
        return 0
    seen[id(value)] = value
    if isinstance(value, np.ndarray):
        return value.nbytes + 112
    held: list[object] = [*getattr(value, "__dict__", {}).values()]
    if isinstance(value, dict):
        held += [*value.keys(), *value.values()]
    elif isinstance(value, (list, tuple, set, deque)):
        held += value
    return sys.getsizeof(value) + sum(held_bytes(one, seen) for one in held)
