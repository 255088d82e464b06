"""Detection: one box for each person, tiles, expected people, and the fitted probability."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.blazepose import LandmarkNetwork
from app.vision.detector import NetworkDetector, detection_odds
from app.vision.detectors.movenet import MoveNetDetector
from app.vision.detectors.tiles import (
    Picture,
)
from app.vision.geometry import Box
from app.vision.movenet import MoveNet
from app.vision.odds import sigmoid
from app.vision.people import Detection
from app.vision.rescoring import ObjectNetwork
from tests.app.vision.conftest import found_share, moved, scores_of

Make = Callable[..., NetworkDetector]


def test_walkers_are_detected_and_nothing_else(
    detector: NetworkDetector,
    street: NDArray[np.uint8],
    walkers: list[Box],
    far_walkers: list[Box],
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


def test_scores_below_the_minimum_are_left_out(
    make_network_detector: Make, street: NDArray[np.uint8]
) -> None:
    everyone = list(scores_of(make_network_detector(min_score=0.0), street).items())
    assert len(everyone) > 2
    some = make_network_detector(min_score=everyone[1][1])
    assert list(scores_of(some, street).items()) == everyone[:2]
    assert make_network_detector(min_score=1.0).detect(street)[0] == []


def test_impossible_limits_are_refused(make_network_detector: Make) -> None:
    with pytest.raises(ValueError, match="min_person_px"):
        make_network_detector(min_person_px=0)
    with pytest.raises(ValueError, match="min_score"):
        make_network_detector(min_score=2)


def test_each_person_of_a_crowd_is_detected_once(
    make_network_detector: Make, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Eighteen walkers in a frame of 894x640, seen in tiles since small people are wanted."""
    height, width = street.shape[:2]
    people = [moved(box, x * width, y * height) for x in range(3) for y in range(2)
              for box in walkers]  # fmt: skip
    detector, frame = make_network_detector(min_person_px=40), np.tile(street, (2, 3, 1))
    assert found_share(detector, frame, people) > 0.9
    boxes = [one.box for one in detector.detect(frame)[0]]
    for number, box in enumerate(boxes):
        assert all(box.iou(other) < 0.4 for other in boxes[number + 1 :])


@pytest.mark.parametrize("x", range(380, 560, 20))
def test_person_across_two_tiles_is_detected_once(
    make_network_detector: Make, street: NDArray[np.uint8], walkers: list[Box], x: int
) -> None:
    """A walker moved across the seams of a frame of 1000x500 on plain asphalt."""
    left, top = round(walkers[1].x) - 12, round(walkers[1].y) - 12
    frame = np.full((500, 1000, 3), street[240:300, 90:130].mean(axis=(0, 1)), np.uint8)
    frame[200:330, x : x + 64] = street[top : top + 130, left : left + 64]
    found, _ = make_network_detector(min_person_px=40).detect(frame)
    expected = moved(walkers[1], x - left, 200 - top)
    assert [one.box.iou(expected) > 0.6 for one in found] == [True]


def test_expected_person_is_detected_more_readily(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    before = scores_of(detector, street)
    for expected in walkers:
        after = scores_of(detector, street, expected)
        raised = [box for box, score in after.items() if score > before.get(box, 0)]
        assert len(raised) == 1 and raised[0].iou(expected) > 0.5
        assert {box for box in after if box not in raised} == set(before) - set(raised)
    assert scores_of(detector, street, Box(0, 0, 10, 20)) == before


class SeesNobody:
    def detect(self, picture: Picture) -> list[Detection]:
        return []


def test_second_detector_only_adds(
    movenet: MoveNet,
    landmark_network: LandmarkNetwork,
    objects: ObjectNetwork,
    detector: NetworkDetector,
    street: NDArray[np.uint8],
) -> None:
    with_both = scores_of(detector, street)
    alone = NetworkDetector([MoveNetDetector(movenet), SeesNobody()], landmark_network, objects)
    found, _ = alone.detect(street)
    assert found
    for one in found:
        assert with_both[one.box] >= one.score
        assert one.windows == ()


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
