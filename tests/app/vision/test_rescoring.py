"""Re-scoring by the detector of objects: people are people, a cat is none."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.detector import NetworkDetector, object_odds
from app.vision.geometry import Box
from app.vision.people import Detection
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def cat() -> NDArray[np.uint8]:
    picture = cv2.imread(str(ROOT / "tests" / "data" / "cat.jpg"))
    assert picture is not None
    return np.asarray(picture, np.uint8)


def gained(detector: NetworkDetector, frame: NDArray[np.uint8], box: Box) -> float:
    return object_odds(*detector.object_log_odds(frame, Detection(box, 0.5)))


def test_walkers_are_people(
    detector: NetworkDetector, street: NDArray[np.uint8], walkers: list[Box], far_walkers: list[Box]
) -> None:
    for box in walkers + far_walkers:
        assert gained(detector, street, box) > 0


@pytest.mark.parametrize("margin", [0, 20, 40])
def test_cat_is_none(detector: NetworkDetector, cat: NDArray[np.uint8], margin: int) -> None:
    height, width = cat.shape[:2]
    box = Box(margin, margin / 2, width - 2 * margin, height - margin)
    assert gained(detector, cat, box) < -1
