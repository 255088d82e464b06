from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.camera import CameraSession
from app.photograph import Estimator
from app.vision.geometry import Box
from index.store import PoseIndex
from tests.app.drawn import ColourDetector, drawn_estimator
from tests.conftest import WALKERS


@pytest.fixture(scope="session")
def street() -> NDArray[np.uint8]:
    """298x320 crop of a street scene with three walkers and two people far away."""
    return cv2.imread(str(WALKERS))


@pytest.fixture(scope="session")
def walkers() -> list[Box]:
    """The three walkers of `street`, marked by hand."""
    return [Box(28, 43, 32, 76), Box(135, 162, 40, 105), Box(227, 147, 40, 104)]


@pytest.fixture(scope="session")
def far_walkers() -> list[Box]:
    """The two people at the upper edge of `street`, marked by hand."""
    return [Box(207, 0, 24, 55), Box(232, 0, 24, 57)]


@pytest.fixture(scope="session")
def drawn(tiny_index: PoseIndex) -> Estimator:
    """An estimator that finds and reads drawn people."""
    return drawn_estimator(tiny_index)


@pytest.fixture
def detector(drawn: Estimator) -> Iterator[ColourDetector]:
    detector = drawn.models.detector
    assert isinstance(detector, ColourDetector)
    detector.searches = detector.room = 0
    detector.blind = False
    yield detector
    detector.room, detector.blind = 0, False


@pytest.fixture
def session(drawn: Estimator) -> CameraSession:
    return CameraSession(drawn)
