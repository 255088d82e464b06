"""Finding people."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.blazepose import BlazePoseDetection, LandmarkNetwork, PoseDetection
from app.vision.detector import (
    Detector,
    HogDetector,
    NetworkDetector,
    detection_odds,
    hog_people,
)
from app.vision.geometry import Box, Detection
from app.vision.movenet import MoveNet
from app.vision.odds import sigmoid

Networks = tuple[MoveNet, PoseDetection, LandmarkNetwork]


@pytest.fixture(scope="module")
def networks(
    movenet: MoveNet, pose_detection: PoseDetection, landmark_network: LandmarkNetwork
) -> Networks:
    return movenet, pose_detection, landmark_network


def found_share(detector: Detector, frame: NDArray[np.uint8], people: list[Box]) -> float:
    boxes = [one.box for one in detector.detect(frame)]
    return float(np.mean([max([p.iou(b) for b in boxes], default=0) >= 0.5 for p in people]))


def moved(box: Box, x: float, y: float) -> Box:
    return Box(box.x + x, box.y + y, box.width, box.height)


@pytest.mark.parametrize("name", ["network", "hog"])
def test_walkers_are_found_and_nobody_else(
    detector: NetworkDetector,
    street: NDArray[np.uint8],
    walkers: list[Box],
    far_walkers: list[Box],
    name: str,
) -> None:
    chosen: Detector = detector if name == "network" else HogDetector()
    assert chosen.name == name
    assert found_share(chosen, street, walkers) == 1
    found = chosen.detect(street)
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)
    for one in found:
        assert max(one.box.iou(person) for person in (*walkers, *far_walkers)) > 0.4


def test_a_large_frame_is_searched_at_reduced_size(
    networks: Networks, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    large = cv2.resize(street, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    people = [box.scaled(4) for box in walkers]
    for detector in (
        HogDetector(min_person_px=200), NetworkDetector(*networks, min_person_px=200)
    ):  # fmt: skip
        assert found_share(detector, large, people) == 1


@pytest.mark.parametrize("shape", [(1, 1, 3), (60, 45, 3), (20, 900, 3), (700, 20, 3)])
@pytest.mark.parametrize("level", [0, 90, 255])
def test_blank_frames_of_any_shape_hold_nobody(
    detector: NetworkDetector, shape: tuple[int, ...], level: int
) -> None:
    blank = np.full(shape, level, np.uint8)
    assert HogDetector().detect(blank) == []
    assert detector.detect(blank) == []


def crowd(street: NDArray[np.uint8], walkers: list[Box]) -> tuple[NDArray[np.uint8], list[Box]]:
    """A frame of 894x640 pixels and its eighteen walkers."""
    height, width = street.shape[:2]
    people = [moved(box, x * width, y * height) for x in range(3) for y in range(2)
              for box in walkers]  # fmt: skip
    return np.tile(street, (2, 3, 1)), people


def test_a_crowd_is_found_once_each(
    networks: Networks, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    """Shown in tiles, since people as small are asked for."""
    detector = NetworkDetector(*networks, min_person_px=40)
    frame, people = crowd(street, walkers)
    assert found_share(detector, frame, people) > 0.9
    boxes = [one.box for one in detector.detect(frame)]
    for number, box in enumerate(boxes):
        assert all(box.iou(other) < 0.4 for other in boxes[number + 1 :])


@pytest.mark.parametrize("x", range(380, 560, 20))
def test_one_person_across_two_tiles_is_one(
    networks: Networks, street: NDArray[np.uint8], walkers: list[Box], x: int
) -> None:
    """A walker moved across the seams of a frame of 1000x500 on plain asphalt."""
    detector = NetworkDetector(*networks, min_person_px=40)
    left, top = round(walkers[1].x) - 12, round(walkers[1].y) - 12
    patch = street[top : top + 130, left : left + 64]
    frame = np.full((500, 1000, 3), street[240:300, 90:130].mean(axis=(0, 1)), np.uint8)
    frame[200:330, x : x + 64] = patch
    found = [one.box for one in detector.detect(frame)]
    expected = moved(walkers[1], x - left, 200 - top)
    assert [box.iou(expected) > 0.6 for box in found] == [True]


def told(found: list[Detection]) -> list[tuple[Box, float]]:
    return [(one.box, one.score) for one in found]


def test_threads_agree(detector: NetworkDetector, street: NDArray[np.uint8]) -> None:
    for chosen in (detector, HogDetector()):
        expected = told(chosen.detect(street))
        with ThreadPoolExecutor(4) as pool:
            for found in pool.map(lambda _, it=chosen: it.detect(street), range(6)):
                assert told(found) == expected


def test_who_is_less_sure_than_asked_is_left_out(
    networks: Networks, street: NDArray[np.uint8]
) -> None:
    for make in (lambda least: NetworkDetector(*networks, min_score=least),
                 lambda least: HogDetector(min_score=least)):  # fmt: skip
        all_of_them: list[Detection] = make(0.0).detect(street)
        second = all_of_them[1].score
        assert told(make(second).detect(street)) == told(all_of_them[:2])
        assert len(all_of_them) > 2
        assert make(1.0).detect(street) == []


def test_who_was_lost_is_believed_more_easily_near_that_place(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    before = {one.box: one.score for one in detector.detect(street)}
    for lost in walkers:
        after = {one.box: one.score for one in detector.detect(street, [lost])}
        raised = [box for box, score in after.items() if score > before.get(box, 0)]
        assert len(raised) == 1 and raised[0].iou(lost) > 0.5
        assert {box for box in after if box not in raised} == set(before) - set(raised)
    far = Box(0, 0, 10, 20)
    assert {one.box: one.score for one in detector.detect(street, [far])} == before


class SeesNobody(PoseDetection):
    """Sees nobody, so that MoveNet is on its own."""

    def __init__(self) -> None:
        """Read no file."""

    def bodies(self, frame: NDArray[np.uint8], least_score: float) -> list[BlazePoseDetection]:
        """Find nobody."""
        return []


def test_a_second_detector_only_adds(
    networks: Networks, detector: NetworkDetector, street: NDArray[np.uint8]
) -> None:
    alone = NetworkDetector(networks[0], SeesNobody(), networks[2])
    with_both = {one.box: one.score for one in detector.detect(street)}
    found = alone.detect(street)
    assert found
    for one in found:
        assert with_both[one.box] >= one.score
        assert one.windows == ()


def test_impossible_limits_are_refused(networks: Networks) -> None:
    for make in (HogDetector, lambda **limits: NetworkDetector(*networks, **limits)):
        with pytest.raises(ValueError, match="min_person_px"):
            make(min_person_px=0)
        with pytest.raises(ValueError, match="min_score"):
            make(min_score=2)


def probability(score: float, margin: float, body: float) -> float:
    return float(sigmoid(detection_odds(np.array([[score, margin, body]])))[0])


@given(score=st.floats(0, 1), margin=st.floats(-5, 5), body=st.floats(0, 1), more=st.floats(0, 2))
def test_each_opinion_makes_the_others_no_less_sure(
    score: float, margin: float, body: float, more: float
) -> None:
    found = probability(score, margin, body)
    assert 0 <= found <= 1
    assert probability(score, margin + more, body) >= found
    assert probability(min(1, score + more), margin, body) >= found
    assert probability(score, margin, min(1, body + more)) >= found


def test_hog_gives_one_box_a_person(street: NDArray[np.uint8], walkers: list[Box]) -> None:
    boxes, margins = hog_people(street, 50)
    assert len(boxes) == len(margins) >= len(walkers)
    assert (margins > 0).all()
    for walker in walkers:
        near = [walker.iou(Box(*box)) for box in boxes.tolist()]
        assert sum(iou > 0.3 for iou in near) == 1
