"""Rectification: places, vectors and boxes of a frame, and of the upright one made of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.optics import Optics, PinholeCamera, Rectification
from tests.support.projection import project

SIDES = st.integers(1, 2000)
OPTICS = st.builds(
    Optics,
    pixel_aspect=st.none() | st.floats(0.25, 4),
    roll_deg=st.none() | st.sampled_from((-90.0, 0.0, 90.0, 180.0, 270.0, 360.0)),
)


@given(SIDES, SIDES, OPTICS)
def test_points_of_a_frame_lie_within_the_rectified_one_and_lead_back(
    height: int, width: int, optics: Optics
) -> None:
    rectification = Rectification.of_frame((height, width), optics)
    corners = np.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    rectified = rectification.points(corners)
    low, high = np.array([-0.5, -0.5]), np.array(rectification.upright[::-1]) - 0.5
    assert (rectified > low - 1e-6).all() and (rectified < high + 1e-6).all()
    # A side is rounded to whole pixels, so at most half of one is lost at either end.
    assert rectified.min(axis=0) == pytest.approx(low, abs=0.51)
    assert rectified.max(axis=0) == pytest.approx(high, abs=0.51)
    assert rectification.points_sent(rectified) == pytest.approx(corners, abs=1e-6)


@given(OPTICS)
def test_vectors_turn_with_the_points_that_they_project_to(optics: Optics) -> None:
    rectification = Rectification.of_frame((300, 400), optics)
    sent = PinholeCamera.of_frame(rectification.square, 70)
    vectors = np.array([[0.3, -0.2, 2.0], [-0.5, 0.4, 1.0], [0.0, 0.0, 3.0]])
    seen = rectification.points_sent(project(sent.centred(rectification.upright), vectors))
    scale = np.array(rectification.sent[::-1]) / rectification.square[::-1]
    places = (project(sent, rectification.axes_sent(vectors)) + 0.5) * scale - 0.5
    assert places == pytest.approx(seen, abs=1e-6)
