"""What every detector must do: networks with HOG, and HOG alone."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.detector import Detector, NetworkDetector
from app.vision.geometry import Box
from app.vision.hog_detector import HogDetector
from tests.app.vision.conftest import found_share, scores_of

Make = Callable[..., Detector]


@pytest.fixture(scope="module", params=["network", "hog"])
def make(
    request: pytest.FixtureRequest,
    make_network_detector: Callable[..., NetworkDetector],
) -> Callable[..., Detector]:
    """Makes either detector with some limits."""
    return make_network_detector if request.param == "network" else HogDetector


def test_walkers_are_detected_and_nothing_else(
    make: Make, street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    detector = make()
    assert detector.name == ("hog" if make is HogDetector else "network")
    assert found_share(detector, street, walkers) == 1
    found = scores_of(detector, street)
    assert list(found.values()) == sorted(found.values(), reverse=True)
    for box in found:
        assert max(box.iou(person) for person in (*walkers, *far_walkers)) > 0.4


def test_large_frame_is_searched_at_reduced_size(
    make: Make, street: NDArray[np.uint8], walkers: list[Box]
) -> None:
    large = cv2.resize(street, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    assert found_share(make(min_person_px=200), large, [box.scaled(4) for box in walkers]) == 1


@pytest.mark.parametrize("shape", [(1, 1, 3), (60, 45, 3), (20, 900, 3), (700, 20, 3)])
@pytest.mark.parametrize("level", [0, 90, 255])
def test_blank_frames_hold_nobody(make: Make, shape: tuple[int, ...], level: int) -> None:
    assert make().detect(np.full(shape, level, np.uint8)) == []


def test_threads_agree(make: Make, street: NDArray[np.uint8]) -> None:
    detector = make()
    expected = scores_of(detector, street)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: scores_of(detector, street), range(6)):
            assert found == expected


def test_scores_below_the_minimum_are_left_out(make: Make, street: NDArray[np.uint8]) -> None:
    everyone = list(scores_of(make(min_score=0.0), street).items())
    assert len(everyone) > 2
    assert list(scores_of(make(min_score=everyone[1][1]), street).items()) == everyone[:2]
    assert make(min_score=1.0).detect(street) == []


def test_impossible_limits_are_refused(make: Make) -> None:
    with pytest.raises(ValueError, match="min_person_px"):
        make(min_person_px=0)
    with pytest.raises(ValueError, match="min_score"):
        make(min_score=2)
