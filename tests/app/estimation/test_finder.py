"""Observing people: each body once, whom others hide, and what is known of each; no networks."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.estimation.finder import Found, Models, PeopleFinder, Target
from app.estimation.results import Person
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.vision.blazepose import PoseReading
from app.vision.geometry import Box, PersonWindow
from app.vision.optics import Optics, PinholeCamera, Rectification
from app.vision.people import LANDMARK_NAMES, Detection
from tests.app.painted import Believing, KnownReader, detected, painted, unseen

SHAPE = (240, 320, 3)
LEFT, RIGHT = Box(40, 30, 60, 160), Box(200, 30, 60, 160)
BODIES = painted(LEFT), painted(RIGHT)
WINDOW = PersonWindow(72, 110, 200)
NEARLY = Box(43, 30, 60, 160)
"""Another detector's box of the person on the left."""


class Finds:
    """A detector that finds what it was told."""

    def __init__(self, people: list[Detection], beside: list[Detection]) -> None:
        self.found = people, beside

    def detect(self, *_: object) -> tuple[list[Detection], list[Detection]]:
        return self.found


def finder(reader: KnownReader, detector: object = None, max_persons: int = 9) -> PeopleFinder:
    models: Any = Models(detector, reader, Believing())  # type: ignore[arg-type]
    return PeopleFinder(models, None, max_persons)


def upload() -> DecodedUpload:
    frame, rectification = np.zeros(SHAPE, np.uint8), Rectification.of_frame(SHAPE, Optics())
    camera = PinholeCamera.of_frame(SHAPE)
    return DecodedUpload(frame, frame, True, None, None, None, camera, rectification)


def observed(
    reader: KnownReader,
    targets: list[Target],
    *,
    landmarks: bool = True,
    tight: bool = False,
    **found: Any,
) -> tuple[list[Person], list[int | None]]:
    return finder(reader).observe(
        upload(), Found(targets, **found), Job(), landmarks=landmarks, tight=tight
    )


def shows(person: Person, reading: PoseReading) -> bool:
    """Whether a person has the landmarks of a reading."""
    seen = person.landmarks
    return seen is not None and np.array_equal(seen.positions, reading.landmarks.positions)


def followed(box: Box, expected: PersonWindow | PoseReading) -> Target:
    return Target(Detection(box, 0.7), expected, followed=True)


def test_people_are_seen_with_what_their_readings_show() -> None:
    reader = KnownReader({LEFT: BODIES[0], RIGHT: BODIES[1]})
    targets = [Target(detected(BODIES[0], LEFT)), Target(Detection(RIGHT, 0.6))]
    people, shown = observed(reader, targets)
    assert shown == [0, 1]
    assert [(one.box, one.detection_score) for one in people] == [(LEFT, 0.9), (RIGHT, 0.6)]
    for one, body in zip(people, BODIES, strict=True):
        assert shows(one, body) and one.next_window == body.next_window
        assert one.silhouette is not None and not one.silhouette.truncated
        assert one.source == "detector" and not one.beside
    without, _ = observed(reader, targets, landmarks=False)
    assert [one.landmarks for one in without] == [None, None]


def test_boxes_are_tight_where_the_network_sees_the_person() -> None:
    loose = Box(20, 20, 100, 200)
    for reading, is_tight in ((BODIES[0], True), (unseen(BODIES[0]), False)):
        ((person,), _) = observed(KnownReader({loose: reading}), [Target(Detection(loose, 0.9))],
                                  tight=True)  # fmt: skip
        assert person.silhouette is not None and person.silhouette.box != loose
        assert person.box == (person.silhouette.box if is_tight else loose)


@pytest.mark.parametrize("best", [0, 1])
def test_of_two_detections_of_one_body_the_better_reading_is_kept(best: int) -> None:
    """Better is the one that fits the keypoints of its own detection."""
    reader = KnownReader({LEFT: BODIES[0], NEARLY: BODIES[0]})
    far = {"x": 40.0, "y": 0.0}
    targets = [
        Target(detected(BODIES[0], box, score, **({} if row == best else far)))
        for row, (box, score) in enumerate([(LEFT, 0.9), (NEARLY, 0.8)])
    ]
    ((person,), shown) = observed(reader, targets)
    assert person.box == (LEFT, NEARLY)[best] and person.detection_score == (0.9, 0.8)[best]
    assert shown == [0, 0]


def test_the_body_of_a_detection_that_another_shows_may_be_seen_beside_it() -> None:
    hidden = painted(Box(75, 30, 60, 160))
    reader = KnownReader({LEFT: BODIES[0], NEARLY: BODIES[0]}, {NEARLY: hidden})
    targets = [Target(detected(BODIES[0], LEFT)), Target(detected(hidden, NEARLY, 0.5))]
    people, _ = observed(reader, targets)
    assert [one.beside for one in people] == [False, True]
    assert shows(people[1], hidden) and people[1].detection_score == 0.5
    assert reader.others == [1]


def test_who_is_perhaps_beside_others_counts_if_a_new_body_is_seen() -> None:
    hidden = painted(Box(75, 30, 60, 160))
    places = [Box(80, 30, 60, 160), Box(60, 30, 60, 160), Box(70, 30, 60, 160)]
    reader = KnownReader({LEFT: BODIES[0]}, {places[0]: hidden, places[1]: hidden})
    beside = [detected(hidden, place, 0.2) for place in places] + [Detection(NEARLY, 0.2)]
    people, shown = observed(reader, [Target(detected(BODIES[0], LEFT))], perhaps_beside=beside)
    assert shown == [0]
    assert [(one.box, one.detection_score, one.beside) for one in people] == [
        (LEFT, 0.9, False),
        # As likely a person as others who are seen only so.
        (places[0], 0.8, True),
    ]
    # The one found first is painted over as well; without keypoints nothing shows another body.
    assert reader.others == [1, 2, 2]


def test_who_is_followed_is_seen_about_the_landmarks() -> None:
    window = BODIES[0].window
    reader = KnownReader({window: BODIES[0], PersonWindow(9, 9, 9): None})
    people, shown = observed(
        reader,
        [
            followed(RIGHT, PersonWindow(9, 9, 9)),
            followed(RIGHT, window),
            followed(LEFT, BODIES[1]),
        ],
    )
    assert shown == [None, 0, 1]
    for person, body in zip(people, BODIES, strict=True):
        assert person.box == body.landmarks.box().grown(0.1)


def test_a_detection_has_the_body_that_windows_of_tracks_show() -> None:
    """Even if its reading fits less; a track's window then leads to its person."""
    reader = KnownReader({LEFT: replace(BODIES[0], next_window=WINDOW)})
    targets = [followed(RIGHT, BODIES[0]), Target(detected(BODIES[0], LEFT, x=30.0)),
               followed(LEFT, BODIES[0])]  # fmt: skip
    ((person,), shown) = observed(reader, targets)
    assert person.next_window == WINDOW and person.box == LEFT
    assert shown == [0, 0, 0]


@pytest.mark.parametrize("near", [0, 1])
def test_of_two_tracks_on_one_body_the_nearer_one_shows_it(near: int) -> None:
    places = [RIGHT, LEFT] if near else [LEFT, RIGHT]
    ((person,), shown) = observed(KnownReader({}), [followed(box, BODIES[0]) for box in places])
    assert shows(person, BODIES[0])
    assert shown == ([None, 0] if near else [0, None])


def test_without_a_silhouette_only_those_count_whom_the_caller_marked() -> None:
    faint = painted(LEFT, 0.1)
    reader = KnownReader({LEFT: faint, RIGHT: BODIES[1]})
    targets = [Target(Detection(LEFT, 0.9)), Target(Detection(RIGHT, 0.9))]
    people, shown = observed(reader, targets)
    assert [one.box for one in people] == [RIGHT] and shown == [None, 0]
    marked, _ = observed(reader, targets, source="boxes")
    assert [one.box for one in marked] == [LEFT, RIGHT]
    assert marked[0].silhouette is None and marked[1].silhouette is not None
    assert [one.detection_score for one in marked] == [None, None]


def test_a_body_marked_twice_is_two_people() -> None:
    reader = KnownReader({LEFT: BODIES[0], NEARLY: BODIES[0]})
    people, shown = observed(reader, [Target(Detection(box, 1.0)) for box in (LEFT, NEARLY)],
                             source="boxes")  # fmt: skip
    assert len(people) == 2 and shown == [0, 1]


@pytest.mark.parametrize("sees_feet", [True, False])
def test_a_body_whose_end_no_landmark_shows_is_truncated(sees_feet: bool) -> None:
    low = Box(40, 72, 60, 160)  # Eight pixels above the lower edge.
    body = painted(low)
    visibility = np.where(
        [name.endswith("ankle") for name in LANDMARK_NAMES], float(sees_feet), 1.0
    )
    marks = replace(body.landmarks, visibility=visibility)
    ((person,), _) = observed(
        KnownReader({low: replace(body, landmarks=marks)}), [Target(Detection(low, 0.9))]
    )
    assert person.silhouette is not None and person.silhouette.truncated is not sees_feet


@pytest.mark.parametrize(("most", "found"), [(9, (2, 2)), (3, (2, 1)), (2, (2, 0)), (1, (1, 0))])
def test_at_most_so_many_are_read_people_first(most: int, found: tuple[int, int]) -> None:
    two = [Detection(LEFT, 0.9), Detection(RIGHT, 0.8)]
    people, beside = finder(KnownReader({}), Finds(two, two), most).search(upload().frame, Job())
    assert (len(people), len(beside)) == found
