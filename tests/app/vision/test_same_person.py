"""Which finds are one person."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.blazepose import LANDMARK_PX, PoseReading
from app.vision.geometry import WINDOW_SCALE, Box, PersonWindow
from app.vision.people import Detection, Landmarks
from app.vision.same_person import first_of_body, tell_apart
from tests.app.painted import detected, painted

BODY_PX = 80.0


def reading(x: float, y: float = 0.0) -> PoseReading:
    """A reading of a body whose middle is at a point."""
    offsets = np.random.default_rng(0).uniform(-BODY_PX, BODY_PX, (33, 2))
    landmarks = Landmarks(np.add(offsets, [x, y]), np.linspace(0.2, 1, 33), np.zeros((33, 3)))
    window = PersonWindow(x, y, 2 * WINDOW_SCALE * BODY_PX)
    probability = np.zeros((LANDMARK_PX, LANDMARK_PX), np.float32)
    return PoseReading(window, landmarks, 1.0, window, probability)


def test_readings_are_grouped_by_body() -> None:
    assert reading(0).body_px == BODY_PX
    assert first_of_body([]) == []
    assert first_of_body([reading(0), reading(1), reading(200), reading(0)]) == [0, 0, 2, 0]


@given(share=st.floats(0, 1), angle=st.floats(-3.14, 3.14))
def test_distant_bodies_are_distinct(share: float, angle: float) -> None:
    apart_px = share * BODY_PX
    other = reading(apart_px * np.cos(angle), apart_px * np.sin(angle))
    first = first_of_body([reading(0), other])
    if share != pytest.approx(0.12):
        assert first == [0, int(share > 0.12)]


def test_without_keypoints_the_boxes_alone_tell_detections_apart() -> None:
    box, nearly, beside = Box(40, 30, 60, 160), Box(43, 30, 60, 160), Box(60, 30, 60, 160)
    body = detected(painted(box), box)
    for other, people, others in (
        (Detection(nearly, 0.5), 1, 1),  # Nothing shows that it is the same body.
        (detected(painted(box), nearly, 0.5), 1, 0),
        (detected(painted(beside), nearly, 0.5), 1, 1),
        (Detection(Box(200, 30, 60, 160), 0.5), 2, 0),
    ):
        assert tuple(map(len, tell_apart([body, other]))) == (people, others)
