"""The people of a frame, found by the tracks' windows and by searches of the whole frame."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.camera import CameraSession
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.following import SEARCH_EVERY_S, TrackedPeopleDetector
from app.tracking.track import Sighting, Track
from tests.app.drawn import ColourDetector, ColourReader, draw, ids, send


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
            assert len(tracked.hypotheses) == 3
    assert detector.searches == 1 + 1 // SEARCH_EVERY_S


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


def test_a_detection_larger_than_the_body_moves_no_box(
    session: CameraSession, detector: ColourDetector
) -> None:
    """A walking frame beside a person, say, that the detector takes for a part of them."""
    send(session, 0.0, (0, 100))
    for step in range(1, 21):
        detector.room = 60 * (step % 2)
        result = send(session, step / 2, (0, 100))
        assert ids(result) == [1]
        box = result.persons[0].box
        assert (box.x, box.width) == (pytest.approx(99.5, abs=2), pytest.approx(30, abs=3))


def followed(
    drawn: Estimator, left: int, *expected_at: int, confirmed: bool = True
) -> list[int | None]:
    """Find a person at 100, and at ``left`` a frame later; return the tracks that led to them.

    All tracks have the window of the first frame, and each is expected somewhere.
    """
    people = TrackedPeopleDetector(drawn.finder)
    before, now = (drawn.decode(Upload(draw((0, x))), Job()) for x in (100, left))
    (first,) = people.find(before, 0.0, [], Job())
    assert first.track is None
    boxes = [replace(first.person.box, x=place) for place in expected_at]
    tracks = [Track(Sighting(replace(first.person, box=box)), 0.0) for box in boxes]
    for number, track in enumerate(tracks):
        track.track_id = number if confirmed else None
    sightings = people.find(now, 0.1, tracks, Job())
    return [None if one.track is None else tracks.index(one.track) for one in sightings]


def test_of_two_tracks_on_one_body_the_nearer_one_has_it(drawn: Estimator) -> None:
    assert followed(drawn, 104, 140, 102) == [1]
    assert followed(drawn, 104, 102, 140) == [0]


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
