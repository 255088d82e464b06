"""Camera sessions, on drawn people whom a detector finds by their colour."""

from __future__ import annotations

import contextlib
import sys
from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.estimator import Estimator
from app.estimation.upload import Upload, UploadError
from app.scheduling.job import DeadlineError, Job
from app.tracking.actions import shipped_model
from app.tracking.parameters import DEFAULTS
from app.tracking.results import TrackedFrame
from app.tracking.session import CameraSession, LateFrameError
from app.vision.blazepose import LANDMARK_PX, Reading
from app.vision.geometry import Box, Detection, Landmarks, PersonWindow
from app.vision.windows import cut_window, window_about, window_to_frame
from tests.conftest import build_tiny_index, png
from tests.support.jobs import ShortJob

ROWS, COLUMNS = 200, 320
PERSON = 90
COLOURS = ((40, 40, 220), (220, 60, 40), (40, 200, 60), (40, 210, 230))


class ColourDetector:
    """Finds the drawn people, also those who touch, and counts how often it is asked."""

    name = "network"

    def __init__(self) -> None:
        self.whole = 0
        self.parts = 0
        self.room = 0

    def detect(self, frame: NDArray[np.uint8], lost: Sequence[Box] = ()) -> list[Detection]:
        if frame.shape[:2] == (ROWS, COLUMNS):
            self.whole += 1
        else:
            self.parts += 1
        boxes = []
        for colour in COLOURS:
            mask = (np.abs(frame.astype(int) - colour).sum(axis=2) < 60).astype(np.uint8)
            left, top, width, height = cv2.boundingRect(mask)
            if height >= PERSON // 2:
                room = self.room
                box = Box(left - 0.5 - room, top - 0.5, width + 2 * room, height)
                boxes.append(Detection(box, 0.9))
        return boxes


class ColourReader:
    """Reads the drawn people: a mask of their colour, and landmarks within it."""

    def __init__(self) -> None:
        self.network = self
        self.lost = False

    def read(
        self,
        frame: NDArray[np.uint8],
        where: Box | PersonWindow,
        keypoints: object = None,
        windows: object = (),
    ) -> Reading:
        window = where if isinstance(where, PersonWindow) else window_about(where)
        picture = cut_window(frame, window, LANDMARK_PX).astype(int)
        middle = picture[
            LANDMARK_PX // 2 - 9 : LANDMARK_PX // 2 + 9, LANDMARK_PX // 2 - 9 : LANDMARK_PX // 2 + 9
        ]
        near = [np.abs(middle - colour).sum(axis=2) < 60 for colour in COLOURS]
        colour = COLOURS[int(np.argmax([np.count_nonzero(mask) for mask in near]))]
        mask = (np.abs(picture - colour).sum(axis=2) < 60).astype(np.uint8)
        left, top, width, height = cv2.boundingRect(mask)
        seen = width > 0 and not self.lost
        shares = np.random.default_rng(0).uniform(0.1, 0.9, (33, 2))
        to_frame = window_to_frame(window, LANDMARK_PX)
        places = np.array([left, top]) + shares * [max(width, 1), max(height, 1)]
        places = places @ to_frame[:, :2].T + to_frame[:, 2]
        corner = to_frame[:, :2] @ np.array([left + width / 2, top + height / 2]) + to_frame[:, 2]
        return Reading(
            window,
            Landmarks(places, np.full(33, 0.9), np.column_stack([shares - 0.5, shares[:, 0]])),
            1.0 if seen else 0.0,
            mask.astype(np.float32),
            PersonWindow(*corner.tolist(), 1.25 * PERSON) if seen else window,
        )


def draw(*people: tuple[int, int], seed: int = 0, columns: int = COLUMNS) -> bytes:
    """An encoded frame of people given by colour and left edge, the last in front."""
    rng = np.random.default_rng(seed)
    frame = rng.normal(150, 2, (ROWS, columns, 3)).astype(np.uint8)
    for colour, left in people:
        cv2.rectangle(frame, (left, 60), (left + 29, 59 + PERSON), COLOURS[colour], -1)
    return png(frame)


@pytest.fixture(scope="module")
def loaded() -> Estimator:
    """An estimator that finds and reads the drawn people."""
    return Estimator(
        build_tiny_index(),
        ColourDetector(),  # type: ignore[arg-type]
        ColourReader(),  # type: ignore[arg-type]
        min_person_px=50,
        max_pixels=10**6,
        max_persons=4,
    )


@pytest.fixture
def detector(loaded: Estimator) -> ColourDetector:
    detector = loaded.finder.detector
    assert isinstance(detector, ColourDetector)
    detector.whole = detector.parts = detector.room = 0
    return detector


@pytest.fixture
def session(loaded: Estimator) -> CameraSession:
    return CameraSession(loaded)


def send(
    session: CameraSession, time: float | None, *people: tuple[int, int], columns: int = COLUMNS
) -> TrackedFrame:
    seed = session.frames
    frame = draw(*people, seed=seed, columns=columns)
    return session.process(Upload(frame), time, 3, Job())


def ids(result: TrackedFrame) -> list[int]:
    return [tracked.track_id for tracked in result.persons]


def learn(session: CameraSession, start: float = 0.0) -> float:
    """Show the empty scene for two seconds."""
    for step in range(20):
        send(session, start + step / 10)
    return start + 2.0


def test_everybody_is_read_on_every_frame_and_the_whole_frame_searched_every_so_often(
    session: CameraSession, detector: ColourDetector
) -> None:
    send(session, 0.0, (0, 10), (1, 200))
    for step in range(1, 21):
        result = send(session, step / 20, (0, 10 + 3 * step), (1, 200 - 3 * step))
        assert ids(result) == [1, 2]
        for tracked, left in zip(result.persons, (10 + 3 * step, 200 - 3 * step), strict=True):
            observed = tracked.person.observed
            assert observed.silhouette is not None and observed.landmarks is not None
            assert observed.silhouette.box.x == pytest.approx(left - 0.5, abs=2)
            assert len(tracked.person.hypotheses) == 3
    assert detector.whole == 1 + 1 // DEFAULTS.detection.search_every_s


def test_a_detection_that_holds_more_than_the_body_moves_nobody(
    session: CameraSession, detector: ColourDetector
) -> None:
    """The walking frame beside somebody, say, that the detector takes for a part of them."""
    send(session, 0.0, (0, 100))
    for step in range(1, 21):
        detector.room = 60 * (step % 2)
        result = send(session, step / 2, (0, 100))
        assert ids(result) == [1]
        box = result.persons[0].person.observed.box
        assert (box.x, box.width) == (pytest.approx(99.5, abs=2), pytest.approx(30, abs=3))


@pytest.mark.parametrize(("place", "told_after_s"), [(2, 0.5), (100, 2.0)])
def test_who_is_no_longer_seen_is_gone_at_once_and_has_left_some_time_later(
    session: CameraSession, place: int, told_after_s: float
) -> None:
    """At the border they have left; who vanishes within the picture may be found again."""
    send(session, 0.0, (0, place))
    assert ids(send(session, 0.1, (0, place))) == [1]
    told = []
    for step in range(2, 26):
        result = send(session, step / 10)
        assert ids(result) == []
        told += [(event.event, event.timestamp) for event in result.events]
    assert told == [("left", pytest.approx(0.1 + told_after_s, abs=0.11))]
    assert session.track_ids == ()


def test_a_thing_that_the_landmark_network_never_sees_a_person_in_is_nobody(
    session: CameraSession, loaded: Estimator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table, say, that the detector takes for somebody."""
    monkeypatch.setattr(loaded.finder.reader, "lost", True)
    for step in range(10):
        assert ids(send(session, step / 2, (0, 100))) == []
    monkeypatch.setattr(loaded.finder.reader, "lost", False)
    assert ids(send(session, 5.0, (0, 100))) == [1]


def test_who_vanished_within_the_picture_and_is_found_again_is_the_same(
    session: CameraSession,
) -> None:
    send(session, 0.0, (0, 100))
    for step in range(1, 15):
        assert ids(send(session, step / 10)) == []
    assert ids(send(session, 1.5, (0, 110))) == [1]


@pytest.mark.parametrize("fps", [1, 2, 5, 10, 15, 30])
@pytest.mark.parametrize("speed", [0, 64, -64])
def test_at_any_frame_rate_one_keeps_an_identity_and_finite_poses(
    session: CameraSession, fps: int, speed: int
) -> None:
    """Who stands still, and who walks 1.2 m/s."""
    for frame in range(min(20, 3 * fps + 1)):
        left = round((20 if speed >= 0 else 270) + speed * frame / fps)
        result = send(session, frame / fps, (0, left))
        assert ids(result) == [1]
        pose = result.persons[0].pose
        assert pose is not None
        assert np.isfinite(pose.points_3d).all() and np.isfinite(pose.points_2d).all()


def test_who_is_there_from_the_start_is_known_at_once(session: CameraSession) -> None:
    first = send(session, 0.0, (0, 50), (1, 200))
    assert first.session == "new" and ids(first) == [1, 2]
    assert [(e.event, e.track_id) for e in first.events] == [("entered", 1), ("entered", 2)]
    second = send(session, 0.1, (0, 50), (1, 200))
    assert second.session == "warm" and ids(second) == [1, 2] and second.events == ()
    assert [tracked.age_frames for tracked in second.persons] == [2, 2]
    assert second.frame_index == 1


def test_two_who_cross_keep_their_identities(session: CameraSession) -> None:
    time = learn(session)
    for step in range(40):
        people = (0, 20 + 6 * step), (1, 260 - 6 * step)
        result = send(session, time + step / 10, *people)
        by_id = {tracked.track_id: tracked.person.observed.box.x for tracked in result.persons}
    assert by_id[1] == pytest.approx(20 + 6 * 39, abs=6)
    assert by_id[2] == pytest.approx(260 - 6 * 39, abs=6)
    assert set(by_id) == {1, 2}


def test_identities_are_never_used_again(session: CameraSession) -> None:
    time, seen = 0.0, set()
    for _ in range(3):
        for step in range(30):
            # Half a second, and then two and a half in which nobody is there.
            people = [(2, 50 + 4 * step)] if step < 5 else []
            seen |= set(ids(send(session, time + step / 10, *people)))
        time += 3
    assert seen == {1, 2, 3}


def test_late_and_repeated_frames_are_refused_and_change_nothing(session: CameraSession) -> None:
    send(session, 5.0, (0, 50))
    for time in (5.0, 4.0, float("nan")):
        with pytest.raises(LateFrameError, match="after 5 s"):
            send(session, time, (0, 50))
    assert session.frames == 1
    assert ids(send(session, 5.1, (0, 50))) == [1]


def test_without_timestamps_the_clock_counts(loaded: Estimator) -> None:
    now = iter((100.0, 100.5, 100.5, 103.0))
    session = CameraSession(loaded, clock=lambda: next(now))
    times = [send(session, None).timestamp for _ in range(4)]
    assert times == pytest.approx([0.0, 0.5, 0.501, 3.001])


def test_another_size_begins_anew_and_says_so(session: CameraSession) -> None:
    send(session, 0.0, (0, 50))
    result = send(session, 0.1, (0, 50), columns=300)
    assert result.reset is not None and "320x200" in result.reset and "300x200" in result.reset
    assert result.session == "warm"
    assert ids(result) == [2]
    assert [(e.event, e.track_id) for e in result.events] == [("left", 1), ("entered", 2)]
    assert send(session, 0.2, (0, 50), columns=300).reset is None


def test_a_long_gap_begins_anew_and_says_so(session: CameraSession) -> None:
    send(session, 0.0, (0, 50))
    result = send(session, 11.0, (0, 50))
    assert result.reset is not None and "11.0 s" in result.reset
    assert ids(result) == [2]


def test_a_cancelled_frame_loses_no_events(loaded: Estimator) -> None:
    session = CameraSession(loaded)
    with pytest.raises(DeadlineError):
        session.process(Upload(draw((0, 50))), 0.0, 3, ShortJob(5), "silhouette")
    result = send(session, 0.1, (0, 50))
    assert ids(result) == [1]
    assert [event.event for event in result.events] == ["entered"]


@pytest.mark.parametrize("steps", range(1, 8))
def test_a_frame_that_failed_half_way_may_be_sent_again(loaded: Estimator, steps: int) -> None:
    session = CameraSession(loaded)
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


def test_frames_a_hair_apart_are_late(session: CameraSession) -> None:
    send(session, 0.0, (0, 50))
    for time in (1e-310, 1e-9, 9e-4):
        with pytest.raises(LateFrameError):
            send(session, time, (0, 50))
    assert ids(send(session, 1e-3, (0, 50))) == [1]
    assert ids(send(session, 0.1, (0, 50))) == [1]


def test_a_broken_frame_changes_nothing(session: CameraSession) -> None:
    send(session, 0.0, (0, 50))
    with pytest.raises(UploadError):
        session.process(Upload(b"no image"), 0.1, 3, Job())
    assert ids(send(session, 0.1, (0, 50))) == [1]


@pytest.mark.parametrize("kind", ["mask", "boxes", "background", "mask alone"])
def test_the_caller_may_say_who_is_there(session: CameraSession, kind: str) -> None:
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
    last = results[-1]
    assert ids(last) == [1]
    assert last.persons[0].person.observed.source == kind.split()[0]
    assert [ids(result) for result in results].count([1]) >= 3


def test_however_many_people_come_and_go_few_are_remembered(session: CameraSession) -> None:
    rng = np.random.default_rng(0)
    for step in range(40):
        lefts = rng.integers(0, COLUMNS - 30, 3)
        send(session, step / 2, *((colour, int(left)) for colour, left in enumerate(lefts)))
    assert len(session.track_ids) <= 8


@pytest.mark.parametrize("fps", [2, 10, 50])
def test_a_track_holds_about_what_the_session_says(session: CameraSession, fps: int) -> None:
    for frame in range(4 * fps + 1):
        send(session, frame / fps, (0, 100))
    (track,) = session._tracks
    shared = set(map(id, [shipped_model(), *shipped_model().__dict__.values()]))
    held = held_bytes(track, shared)
    assert held < 2 * session.memory_bytes
    if fps == 10:
        assert held > session.memory_bytes / 2


def held_bytes(value: object, seen: set[int]) -> int:
    """Bytes of an object and of all that it holds but what was seen before."""
    if id(value) in seen:
        return 0
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        return value.nbytes + 112
    held: list[object] = [*getattr(value, "__dict__", {}).values()]
    if isinstance(value, dict):
        held += [*value.keys(), *value.values()]
    elif isinstance(value, (list, tuple, set, deque)):
        held += value
    return sys.getsizeof(value) + sum(held_bytes(one, seen) for one in held)
