"""Detection: one box for each person, tiles, expected people, and the fitted probability."""

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.networks.probabilities import sigmoid
from app.vision.blazepose import PoseReading
from app.vision.detector import NetworkDetector, detection_odds
from app.vision.detectors.hog import hog_margin
from app.vision.detectors.tiles import Picture
from app.vision.geometry import Box, PersonWindow
from app.vision.people import Detection
from tests.app.painted import detected, painted
from tests.app.vision.conftest import found_share, moved, scores_of

MIN_SCORE = "app.vision.detector.MIN_DETECTION_SCORE"


def test_walkers_are_detected_and_nothing_else(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    assert found_share(detector, street, walkers) == 1
    found = scores_of(detector, street)
    assert list(found.values()) == sorted(found.values(), reverse=True)
    for box in found:
        assert max(box.iou(person) for person in (*walkers, *far_walkers)) > 0.4


@pytest.mark.parametrize("shape", [(1, 1, 3), (60, 45, 3), (20, 900, 3), (700, 20, 3)])
@pytest.mark.parametrize("level", [0, 90, 255])
def test_blank_frames_hold_nobody(
    detector: NetworkDetector, shape: tuple[int, ...], level: int
) -> None:
    assert detector.detect(np.full(shape, level, np.uint8)) == ([], [])


def test_each_person_of_a_crowd_is_detected_once(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Eighteen walkers in a frame of 894x640, seen in tiles since small people are wanted."""
    height, width = street.shape[:2]
    people = [moved(box, x * width, y * height) for x in range(3) for y in range(2)
              for box in walkers]  # fmt: skip
    frame = np.tile(street, (2, 3, 1))
    assert found_share(detector, frame, people, 40) > 0.9
    boxes = [one.box for one in detector.detect(frame, min_person_px=40)[0]]
    for number, box in enumerate(boxes):
        assert all(box.iou(other) < 0.4 for other in boxes[number + 1 :])


@given(score=st.floats(0, 1), margin=st.floats(-5, 5), body=st.floats(0, 1), more=st.floats(0, 2))
def test_probability_never_falls_with_a_score(
    score: float, margin: float, body: float, more: float
) -> None:
    scores = [
        [score, margin, body],
        [score, margin + more, body],
        [min(1, score + more), margin, body],
        [score, margin, min(1, body + more)],
    ]
    first, *others = sigmoid(detection_odds(np.array(scores))).tolist()
    assert 0 <= first <= min(others) <= 1


BLANK = np.full((240, 320, 3), 127, np.uint8)
LEFT, RIGHT = Box(40, 30, 60, 160), Box(200, 30, 60, 160)
WINDOW = PersonWindow.about_box(LEFT)


class Knows:
    """A detector, objects and landmarks that were told what they see."""

    def __init__(
        self, *found: Detection, person: float = 0.0, other: float = 0.0, presence: float = 1.0
    ) -> None:
        self.found, self.odds, self.presence = list(found), (person, other), presence
        self.asked = 0

    def detect(self, picture: Picture) -> list[Detection]:
        return self.found

    def log_odds(self, frame: NDArray[np.uint8], window: PersonWindow) -> tuple[float, float]:
        self.asked += 1
        return self.odds

    def read(self, frame: NDArray[np.uint8], window: PersonWindow) -> PoseReading:
        return replace(painted(LEFT), presence=self.presence)


def told(
    *people: Detection,
    bodies: tuple[Detection, ...] = (),
    objects: Knows | None = None,
    presence: float = 1.0,
) -> NetworkDetector:
    landmarks: Any = Knows(presence=presence)
    seen: Any = objects or Knows(person=-9, other=-9)
    return NetworkDetector([Knows(*people), Knows(*bodies)], landmarks, seen)


def probability(score: float, box: Box = LEFT, body: float = 0.0) -> float:
    """Of a person with MoveNet's score, HOG's margin on a blank frame, and a body's score."""
    scores = np.array([[score, hog_margin(BLANK, box), body]])
    return float(sigmoid(detection_odds(scores))[0])


def score_of(wanted: float) -> float:
    """The score of MoveNet at which a person is about so likely."""
    scores = np.zeros((490, 3))
    scores[:, 0], scores[:, 1] = np.arange(0.02, 1, 0.002), hog_margin(BLANK, LEFT)
    return float(scores[np.abs(sigmoid(detection_odds(scores)) - wanted).argmin(), 0])


@pytest.mark.parametrize(
    ("chance", "person", "other", "change"),
    [
        (0.5, 3.0, -3.0, 1),
        (0.5, -3.0, 3.0, -1),
        # Whom the detectors hardly see is never less likely by the objects beside them.
        (0.25, 3.0, -3.0, 1),
        (0.25, -3.0, 3.0, 0),
        # Who is no doubt a person, or nobody, is not compared.
        (0.9, -3.0, 3.0, 0),
        (0.17, 3.0, -3.0, 0),
    ],
)
def test_objects_decide_about_doubtful_people(
    chance: float, person: float, other: float, change: int
) -> None:
    score, objects = score_of(chance), Knows(person=person, other=other)
    detector = told(Detection(LEFT, score), objects=objects)
    # A person is expected, so that everybody is reported who is not less likely.
    found, _ = detector.detect(BLANK, [LEFT])
    odds = logit_of(found[0].score) if found else -math.inf
    assert np.sign(round(odds - 1 - logit_of(probability(score)), 6)) == change
    assert objects.asked == (0.2 <= probability(score) < 0.8)
    # Nor is anybody compared who is known, and so expected, wherever they are a little later.
    ((known,), _) = detector.detect(BLANK, (), [Box(60, 35, 60, 150)])
    assert logit_of(known.score) - 1 == pytest.approx(logit_of(probability(score)))


def test_the_likeliest_within_reach_of_the_expected_person_is_likelier(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(MIN_SCORE, 0.0)
    places = [LEFT, Box(60, 30, 60, 160), RIGHT]
    scores = [score_of(0.4), score_of(0.5), score_of(0.6)]
    detector = told(*map(Detection, places, scores))
    before, after = (
        {one.box: one.score for one in detector.detect(BLANK, expected)[0]}
        for expected in ((), [Box(50, 60, 60, 160)])
    )
    # The first two show one person; the first is kept.
    assert list(before) == [RIGHT, LEFT]
    assert after[RIGHT] == before[RIGHT]
    assert logit_of(after[LEFT]) == pytest.approx(logit_of(before[LEFT]) + 1)


def logit_of(probability: float) -> float:
    return math.log(probability / (1 - probability))


def test_a_body_adds_its_window_to_the_likelier_person_about_it() -> None:
    body = Detection(WINDOW.circle_box(), 0.7, None, (WINDOW,))
    people = [Detection(LEFT, 0.3), Detection(Box(66, 10, 60, 200), 0.4), Detection(RIGHT, 0.5)]
    found, scores, _ = told(*people, bodies=(body,)).candidates(BLANK)
    assert [one.windows for one in found] == [(), (WINDOW,), ()]
    assert scores[:, 0].tolist() == [0.3, 0.4, 0.5]
    assert scores[:, 2].tolist() == [0, 0.7, 0]


@pytest.mark.parametrize("presence", [0.4, 0.6])
def test_a_body_that_the_first_detector_misses_counts_if_landmarks_show_it(presence: float) -> None:
    body = Detection(WINDOW.circle_box(), 0.7, None, (WINDOW,))
    detector = told(Detection(RIGHT, 0.5), bodies=(body,), presence=presence)
    found, scores, _ = detector.candidates(BLANK)
    assert [one.windows for one in found] == [(), (WINDOW,)][: 1 + (presence > 0.5)]
    if presence > 0.5:
        assert found[1].box == painted(LEFT).landmarks.box()
        assert scores[1].tolist() == [0, 0, 0.7]


def test_others_in_the_boxes_of_people_are_perhaps_beside_them() -> None:
    """If their keypoints differ, and they are likely enough; likewise people who are unlikely."""
    body = painted(LEFT)
    near = Box(45, 30, 60, 160)
    same, other = (detected(body, near, 0.5, x=x) for x in (2.0, 30.0))
    people = detected(body, LEFT, 0.8), replace(other, box=RIGHT, score=score_of(0.05))
    found, beside = told(people[0], same, other, people[1]).detect(BLANK)
    assert [one.box for one in found] == [LEFT]
    assert [one.keypoints for one in beside] == [other.keypoints]
    assert beside[0].score == pytest.approx(probability(0.5, near))
    doubtful = replace(other, box=Box(90, 30, 60, 160), score=score_of(0.25))
    found, beside = told(people[0], doubtful).detect(BLANK)
    assert [one.box for one in found] == [LEFT] and [one.box for one in beside] == [doubtful.box]


@pytest.mark.parametrize("share", [0.4, 0.6, 1.0])
@pytest.mark.parametrize("number", [0, 1])
def test_a_person_who_fills_the_frame_is_found(
    detector: NetworkDetector,
    street: NDArray[np.uint8],
    walkers: list[Box],
    share: float,
    number: int,
) -> None:
    """From the head down to the hips or the feet, enlarged to the size of a camera's frame."""
    left, top, right, bottom = walkers[number].pixels()
    part = street[top : top + round(share * (bottom - top)), left:right]
    close = cv2.resize(part, None, fx=480 / len(part), fy=480 / len(part))
    found, _ = detector.detect(np.asarray(close, np.uint8))
    assert max(one.box.height for one in found) > 240
