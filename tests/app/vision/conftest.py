"""What the tests of vision share: a small street scene, and the networks that ship."""

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.networks.shipped import file_of
from app.vision.blazepose import LandmarkNetwork, MaskNetwork
from app.vision.detector import NetworkDetector, ObjectNetwork
from app.vision.detectors.blazepose import BlazePoseDetector
from app.vision.geometry import Box, PersonWindow
from app.vision.judgement import load_photograph_models
from app.vision.movenet import KeypointReader, MoveNet, MoveNetDetector
from app.vision.person_reader import PersonReader

PLACES, SIDES, ROLLS = st.floats(-300, 900), st.floats(1, 900), st.floats(-360, 360)
PERSON_WINDOWS = st.builds(PersonWindow, PLACES, PLACES, SIDES, ROLLS)


def moved(box: Box, x: float, y: float) -> Box:
    return Box(box.x + x, box.y + y, box.width, box.height)


def found_share(
    detector: NetworkDetector,
    frame: NDArray[np.uint8],
    people: list[Box],
    min_person_px: float | None = None,
) -> float:
    boxes = [one.box for one in detector.detect(frame, min_person_px=min_person_px)[0]]
    return float(np.mean([max([p.iou(b) for b in boxes], default=0) >= 0.5 for p in people]))


def scores_of(
    detector: NetworkDetector, frame: NDArray[np.uint8], *expected: Box
) -> dict[Box, float]:
    return {one.box: one.score for one in detector.detect(frame, expected)[0]}


@pytest.fixture(scope="session")
def movenet() -> MoveNet:
    return MoveNet(file_of("movenet"))


@pytest.fixture(scope="session")
def reader(movenet: MoveNet) -> KeypointReader:
    return KeypointReader(movenet)


@pytest.fixture(scope="session")
def landmark_network() -> LandmarkNetwork:
    return LandmarkNetwork(file_of("pose_landmarks"))


@pytest.fixture(scope="session")
def mask_network() -> MaskNetwork:
    return MaskNetwork(file_of("pose_mask"))


@pytest.fixture(scope="session")
def body_detector() -> BlazePoseDetector:
    return BlazePoseDetector(file_of("pose_detection"))


@pytest.fixture(scope="session")
def objects() -> ObjectNetwork:
    return ObjectNetwork(file_of("objects"))


@pytest.fixture(scope="session")
def detector(
    movenet: MoveNet,
    body_detector: BlazePoseDetector,
    landmark_network: LandmarkNetwork,
    objects: ObjectNetwork,
) -> NetworkDetector:
    detectors = MoveNetDetector(movenet, movenet), body_detector
    return NetworkDetector(detectors, landmark_network, objects)


@pytest.fixture(scope="session")
def person_reader(
    landmark_network: LandmarkNetwork, mask_network: MaskNetwork, reader: KeypointReader
) -> PersonReader:
    return PersonReader(landmark_network, mask_network, reader, load_photograph_models())
