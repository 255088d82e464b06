"""The people of a frame, found by the tracks' windows and by searches of the whole frame.

Poses are not matched here: the people of these sessions have none.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from app.camera import CameraSession
from app.estimation.results import Person
from app.estimation.upload import DecodedUpload, Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.following import (
    CALM_SEARCH_EVERY_S,
    EMPTY_SEARCH_EVERY_S,
    SEARCH_EVERY_S,
    STILL_SEARCH_EVERY_S,
    TrackedPeopleDetector,
)
from app.tracking.track import Track
from app.tracking.zones import Zone
from app.vision.judgement import Trust
from app.vision.optics import PinholeCamera
from tests.app.drawn import PERSON, ColourDetector, ColourReader, draw, ids, send
from tests.conftest import png
from tests.golden import pictures


class WithoutPoses(Estimator):
    def fit(
        self, people: Sequence[Person], camera: PinholeCamera, n: int, job: Job
    ) -> list[Person | None]:
        return list(people)


@pytest.fixture
def session(drawn: Estimator) -> CameraSession:
    limits = {"min_person_px": 50, "max_pixels": 10**6, "max_persons": 4}
    return CameraSession(WithoutPoses(drawn.index, drawn.models, **limits))


def test_every_frame_reads_everyone_and_some_search_the_whole_frame(
    session: CameraSession, detector: ColourDetector
) -> None:
    send(session, 0.0, (0, 10), (1, 200))
    for step in range(1, 21):
        lefts = 10 + 3 * step, 200 - 3 * step
        result = send(session, step / 20, (0, lefts[0]), (1, lefts[1]))
        assert ids(result) == [1, 2]
        for tracked, left in zip(result.persons, lefts, strict=True):
            assert tracked.silhouette is not None and tracked.landmarks is not None
            assert tracked.silhouette.box.x == pytest.approx(left - 0.5, abs=2)
    assert detector.searches == 1 + 1 // CALM_SEARCH_EVERY_S


def test_a_search_for_a_person_who_is_lost_reads_nobody_twice(
    session: CameraSession, detector: ColourDetector, drawn: Estimator
) -> None:
    send(session, 0.0, (0, 10), (1, 200))
    reader = drawn.models.reader
    assert isinstance(reader, ColourReader)
    before, searches = reader.passes, detector.searches
    send(session, 0.1, (0, 12))
    assert detector.searches == searches + 1
    assert reader.passes == before + 2


def test_a_person_who_does_not_move_is_not_read_in_every_frame(
    session: CameraSession, drawn: Estimator
) -> None:
    reader = drawn.models.reader
    assert isinstance(reader, ColourReader)

    def passes(time: float, *people: tuple[int, int]) -> int:
        before = reader.passes
        assert ids(send(session, time, *people)) == [1, 2]
        return reader.passes - before

    def walks(step: int) -> tuple[int, int]:
        return 0, 10 + step

    # Another person walks all the time, and the frame is searched every 0.4 s.
    read = [passes(step / 10, walks(step), (1, 200)) for step in range(80)]
    assert min(read[:30]) == 2
    assert read[36:].count(1) > 2 * read[36:].count(2) > 0
    assert passes(8.0, walks(80), (1, 206)) == passes(8.1, walks(81), (1, 206)) == 2


def test_movenet_looks_at_tracked_people_now_and_then(
    session: CameraSession, drawn: Estimator
) -> None:
    """Every 0.2 s, in the whole frame or in their windows; in between, landmarks alone follow."""
    reader = drawn.models.reader
    detector = drawn.models.detector
    assert isinstance(reader, ColourReader) and isinstance(detector, ColourDetector)
    looks, searches = [], []
    for step in range(41):
        before = reader.looks, detector.searches
        send(session, 0.101 * step, (0, 10 + 4 * step))
        looks.append(reader.looks - before[0])
        searches.append(detector.searches - before[1])
    # Where the frame was searched, nobody has to be looked at besides.
    once = [one + other for one, other in zip(looks, searches, strict=True)]
    assert once == [int(step % 2 == 0) for step in range(41)]
    assert sum(looks) >= 3 and sum(searches) >= 3


@pytest.mark.parametrize("each", [False, True])
def test_silhouettes_move_along_between_looks_unless_each_is_wanted(
    session: CameraSession, drawn: Estimator, monkeypatch: pytest.MonkeyPatch, *, each: bool
) -> None:
    reader, masks = drawn.models.reader, list[object]()
    monkeypatch.setattr(reader, "with_mask", lambda one: masks.append(one) or one)
    for step in range(31):
        left = 10 + 2 * step
        frame = Upload(draw((0, left), seed=step))
        (person,) = session.process(frame, step / 30, 0, Job(), drawn=each).persons
        assert person.silhouette is not None
        assert person.box == person.silhouette.box
        assert person.box.x == pytest.approx(left - 0.5, abs=2)
        assert person.silhouette.area_px == pytest.approx(30 * PERSON, rel=0.1)
    assert len(masks) == 31 if each else 3 <= len(masks) <= 5


def test_an_unchanged_person_is_estimated_anew_if_something_else_is_asked(
    session: CameraSession, drawn: Estimator
) -> None:
    reader = drawn.models.reader
    assert isinstance(reader, ColourReader)
    frame = draw((0, 100))

    def passes(time: float, n: int) -> int:
        before = reader.passes
        session.process(Upload(frame), time, n, Job())
        return reader.passes - before

    for step in range(40):
        passes(step / 10, 3)
    read = next(step for step in range(40, 50) if passes(step / 10, 3))
    assert passes((read + 1) / 10, 3) == 0
    assert passes((read + 2) / 10, 0) == 1


def decoded(drawn: Estimator, *people: tuple[int, int]) -> DecodedUpload:
    return drawn.decode(Upload(draw(*people)), Job())


@pytest.mark.parametrize("beside", [False, True])
def test_a_person_who_was_hardly_seen_behind_others_is_not_searched_for_at_once(
    drawn: Estimator, detector: ColourDetector, beside: bool
) -> None:
    people = TrackedPeopleDetector(drawn.finder)
    both, one = decoded(drawn, (0, 10), (1, 200)), decoded(drawn, (1, 200))
    tracks = []
    for number, found in enumerate(people.find(both, 0.0, [], Job())[0]):
        tracks.append(Track(replace(found, beside=beside), 0.0))
        tracks[-1].confirm(number, 0.0, ())
    detector.searches = 0
    assert len(people.find(one, 0.1, tracks, Job())[0]) == 1
    assert detector.searches == (0 if beside else 1)


def followed(
    drawn: Estimator, left: int, *expected_at: int, confirmed: bool = True, time: float = 0.1
) -> list[int | None]:
    """Find a person at 100, and at ``left`` at a later time; return the tracks that led to them.

    All tracks have the window of the first frame, and each is expected somewhere.
    """
    people = TrackedPeopleDetector(drawn.finder)
    before, now = decoded(drawn, (0, 100)), decoded(drawn, (0, left))
    (first,), in_window = people.find(before, 0.0, [], Job())
    assert not in_window
    boxes = [replace(first.box, x=place) for place in expected_at]
    tracks = [Track(replace(first, box=box), 0.0) for box in boxes]
    for number, track in enumerate(tracks):
        track.track_id = number if confirmed else None
    found, in_window = people.find(now, time, tracks, Job())
    led = [in_window.get(row) for row in range(len(found))]
    return [None if track is None else tracks.index(track) for track in led]


def test_a_detected_person_whom_the_window_of_a_track_shows_is_its_person(
    drawn: Estimator, detector: ColourDetector
) -> None:
    """In a quick fall, a person is soon far from the expected place."""
    assert followed(drawn, 104, 10, time=SEARCH_EVERY_S, confirmed=False) == [0]
    # Another track expects the person there; appearance and place decide.
    assert followed(drawn, 104, 10, 98, time=SEARCH_EVERY_S, confirmed=False) == [None]
    assert detector.searches == 4


def test_a_person_outside_their_window_is_found_by_a_search(
    drawn: Estimator, detector: ColourDetector
) -> None:
    assert followed(drawn, 104, 100) == [0] and detector.searches == 1
    assert followed(drawn, 260, 100) == [None] and detector.searches == 3


@pytest.mark.parametrize(("place", "confirmed"), [(100, False), (-10, True)])
def test_unconfirmed_tracks_and_people_at_the_border_cause_no_search(
    drawn: Estimator, detector: ColourDetector, place: int, confirmed: bool
) -> None:
    assert followed(drawn, 260, place, confirmed=confirmed) == []
    assert detector.searches == 1


def test_for_a_person_who_fell_and_is_not_seen_searches_come_at_their_interval(
    drawn: Estimator, detector: ColourDetector
) -> None:
    people = TrackedPeopleDetector(drawn.finder)
    shown, empty = decoded(drawn, (0, 100)), decoded(drawn)
    (person,), _ = people.find(shown, 0.0, [], Job())
    track = Track(person, 0.0)
    track.track_id, track.place.lies_at = 1, person.box
    detector.searches = 0
    for step in range(100, 200):  # Ten seconds, later.
        assert people.find(empty, step / 10, [track], Job()) == ([], {})
    assert 20 <= detector.searches <= 10 / SEARCH_EVERY_S


def still(session: CameraSession, *people: tuple[int, int], light: float = 150) -> None:
    """Send three seconds of people who do not move, five frames a second."""
    for step in range(15):
        result = send(session, step / 5, *people, light=light)
        assert ids(result) == [*range(1, 1 + len(people))]


@pytest.mark.parametrize(
    ("people", "interval_s"),
    [((), EMPTY_SEARCH_EVERY_S), (((0, 10), (1, 200)), STILL_SEARCH_EVERY_S)],
)
def test_a_still_scene_is_searched_rarely(
    session: CameraSession,
    detector: ColourDetector,
    people: tuple[tuple[int, int], ...],
    interval_s: float,
) -> None:
    still(session, *people)
    detector.searches = 0
    for step in range(15, 75):
        send(session, step / 5, *people)
    assert detector.searches == 12 / interval_s


@pytest.mark.parametrize(("flicker", "sure"), [(0, False), (20, False), (20, True)])
def test_if_a_walker_is_surely_read_or_nothing_changes_around_searches_are_rarer(
    session: CameraSession,
    detector: ColourDetector,
    monkeypatch: pytest.MonkeyPatch,
    *,
    flicker: int,
    sure: bool,
) -> None:
    monkeypatch.setattr(Trust, "is_right", property(lambda trust: sure))
    every = SEARCH_EVERY_S if flicker and not sure else CALM_SEARCH_EVERY_S
    times = [0.201 * step for step in range(9)]
    for step, time in enumerate(times):
        send(session, time, (0, 10 + 5 * step), light=150 + flicker * (step % 2))
    assert detector.searches == 1 + times[-1] // every


def test_of_a_still_empty_scene_no_jpeg_is_decoded_and_the_answers_are_the_same(
    drawn: Estimator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person enters, leaves and comes back; a file breaks off."""
    uploads = []
    decode = drawn.decode

    def counted(upload: Upload, job: Job, **how: Any) -> DecodedUpload:
        uploads.append(upload)
        return decode(upload, job, **how)

    monkeypatch.setattr(drawn, "decode", counted)
    by_file, by_pixels = CameraSession(drawn), CameraSession(drawn)
    for step in range(90):
        people = [(0, 10 * (step % 20))] if 20 <= step % 50 < 30 else []
        drawn_people = draw(*people, seed=step)
        file = cv2.imencode(".jpg", drawn_people, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        if step == 18:
            file = file[: len(file) * 2 // 3]
        pixels = decode(Upload(file), Job()).frame
        zones = [Zone("far", "watch", np.array([[900.0, 0], [950, 0], [950, 50]]))] * (step > 85)
        by_file.zones = by_pixels.zones = zones
        one, other = (
            session.process(Upload(frame), step / 5, 0, Job())
            for session, frame in ((by_file, file), (by_pixels, pixels))
        )
        for name in ("frame_index", "timestamp", "session", "events"):
            assert getattr(one, name) == getattr(other, name)
        assert [(p.track_id, p.box) for p in one.persons] == [
            (p.track_id, p.box) for p in other.persons
        ]
        assert one.frame.shape == other.frame.shape
        for mine, theirs in zip(
            vars(one.camera).values(), vars(other.camera).values(), strict=True
        ):
            np.testing.assert_array_equal(mine, theirs)
        assert ("truncated" in one.warnings) == (step == 18)
        assert ("zone_outside" in one.warnings) == (step > 85)
    files = sum(isinstance(upload.frame, bytes) for upload in uploads)
    assert 40 < files < 75


@pytest.mark.parametrize("known", [(), ((1, 200),)])
def test_a_person_who_enters_a_still_scene_is_found_in_that_frame(
    session: CameraSession, known: tuple[tuple[int, int], ...]
) -> None:
    still(session, *known)
    assert len(ids(send(session, 3.0, *known, (0, 20)))) == len(known) + 1


def test_a_person_beside_one_who_walks_is_found(session: CameraSession) -> None:
    """A walking person is no change, but neither do they hide one."""
    for step in range(15):
        send(session, step / 5, (0, 10 + 4 * step))
    assert ids(send(session, 3.0, (0, 70), (1, 130))) == [1, 2]


def test_a_person_who_was_there_before_they_were_recognised_is_found(
    session: CameraSession, detector: ColourDetector
) -> None:
    detector.blind = True
    for step in range(15):
        assert not send(session, step / 5, (0, 100)).persons
    detector.blind = False
    found = [ids(send(session, 3 + step / 5, (0, 100))) for step in range(61)]
    assert found[0] == [] and found[-1] == [1]


def test_a_person_who_moved_and_was_missed_has_more_than_one_chance(
    session: CameraSession, detector: ColourDetector
) -> None:
    still(session)
    detector.blind = True
    assert not send(session, 3.0, (0, 100)).persons
    detector.blind = False
    assert ids(send(session, 3.2, (0, 100))) == [1]


def test_slow_changes_of_light_add_up_and_infrared_causes_a_search_at_once(
    session: CameraSession, detector: ColourDetector
) -> None:
    still(session)
    detector.searches = 0
    for step in range(10):
        send(session, 3 + step / 5, light=150 - step)
    assert detector.searches >= 3
    for step in range(25, 40):
        send(session, step / 5, light=141)
    detector.searches = 0
    send(session, 8.0, light=90)
    assert detector.searches == 1


@pytest.mark.parametrize("turns", [False, True])
def test_a_cameras_clock_is_no_change_and_its_turning_is(
    session: CameraSession, detector: ColourDetector, turns: bool
) -> None:
    wall = cv2.resize(pictures.decode(pictures.EMPTY_YARD), (480, 200))
    for step in range(45):
        if step == 15:
            detector.searches = 0
        left = 4 * step if turns else 0
        frame = wall[:, left : left + 300].copy()
        cv2.putText(frame, f"12:00:{step // 5:02}", (4, 20), 0, 0.5, (255, 255, 255), 1)
        session.process(Upload(png(frame)), step / 5, 1, Job())
    assert detector.searches == pytest.approx(6 / SEARCH_EVERY_S if turns else 0, abs=3)


def test_a_person_lost_in_a_still_scene_is_searched_for_until_the_track_ends(
    session: CameraSession, detector: ColourDetector
) -> None:
    """At once while a window shows where; then as often as in a scene that is not still."""
    still(session, (0, 100), (1, 200))
    searched = []
    for step in range(15, 24):
        detector.searches = 0
        assert ids(send(session, step / 5, (1, 200))) == [2]
        searched.append(detector.searches)
    assert searched[:2] == [1, 1] and 4 <= sum(searched) <= 6
    # A lower threshold near the lost person; the other one needs no comparison with objects.
    assert [box.x for box in detector.lost] == pytest.approx([99.5], abs=1)
    assert [box.x for box in detector.known] == pytest.approx([199.5], abs=1)


def test_who_is_lost_behind_others_in_a_still_scene_is_searched_for_with_the_next_frame(
    drawn: Estimator, detector: ColourDetector
) -> None:
    """The scene is as still as before, but not everybody is seen."""
    people = TrackedPeopleDetector(drawn.finder)
    both, one = decoded(drawn, (0, 10), (1, 200)), decoded(drawn, (1, 200))
    tracks: list[Track] = []
    for step in range(26):
        found, _ = people.find(both, step / 10, tracks, Job())
        found = sorted((replace(one, beside=True) for one in found), key=lambda one: one.box.x)
        for track, person in zip(tracks, found, strict=bool(tracks)):
            track.see(person, step / 10)
        if not tracks:
            tracks = [Track(person, 0.0) for person in found]
            for number, track in enumerate(tracks):
                track.confirm(number, 0.0, ())
    searches = []
    for step in (26, 27):
        detector.searches = 0
        people.find(one, step / 10, tracks, Job())
        tracks[1].see(replace(found[1], beside=True), step / 10)
        searches.append(detector.searches)
    assert searches == [0, 1]


def test_unconfirmed_tracks_are_searched_for_in_a_still_scene(
    drawn: Estimator, detector: ColourDetector
) -> None:
    people = TrackedPeopleDetector(drawn.finder)
    frame = decoded(drawn, (0, 100))
    tracks = [Track(one, 0.0) for one in people.find(frame, 0.0, [], Job())[0]]
    for step in range(1, 31):
        if step == 15:
            detector.searches = 0
        found, _ = people.find(frame, step / 5, tracks, Job())
        for track, person in zip(tracks, found, strict=True):
            track.see(person, step / 5)
    assert detector.searches >= 6


def test_a_walker_enters_the_still_yard(estimator: Estimator) -> None:
    session = CameraSession(estimator)
    rng = np.random.default_rng(0)

    def seen(frame: pictures.Picture, time: float) -> list[int]:
        noisy = np.clip(frame + rng.normal(0, 2, frame.shape), 0, 255).astype(np.uint8)
        jpeg = cv2.imencode(".jpg", noisy)[1].tobytes()
        return ids(session.process(Upload(jpeg), time, 1, Job()))

    for step in range(15):
        assert not seen(pictures.decode(pictures.EMPTY_YARD), step / 5)
    assert seen(pictures.walk(1)[0][0], 3.0) == [1]
