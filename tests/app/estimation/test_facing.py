"""Which way skeletons face."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.estimation.posture import azimuth_deg, front_share, heading_shares
from index.skeleton import POINTS, camera_rotation, rotate_clockwise, side_rows, wrap_degrees


@pytest.mark.parametrize("azimuth", [-170.0, -90.0, -30.0, 0.0, 45.0, 90.0, 179.0])
# From above, depth is foreshortened.
@pytest.mark.parametrize(("elevation", "atol"), [(0.0, 1e-9), (30.0, 5.0)])
def test_azimuth_is_that_of_the_camera(azimuth: float, elevation: float, atol: float) -> None:
    body = np.zeros((POINTS, 3))
    body[side_rows("shoulder", "hip"), 0] = 0.2, -0.2, 0.2, -0.2
    body[side_rows("shoulder"), 1] = 0.5
    seen = azimuth_deg(body @ camera_rotation(azimuth, elevation).T)
    assert wrap_degrees(seen - azimuth) == pytest.approx(0, abs=atol)


@pytest.mark.parametrize("angle", [-135.0, -90.0, 15.0, 90.0, 180.0])
def test_rotating_the_picture_does_not_change_the_azimuth(angle: float) -> None:
    bodies = np.random.default_rng(0).normal(size=(20, POINTS, 3))
    rotated = azimuth_deg(rotate_clockwise(bodies, angle))
    assert_allclose((rotated - azimuth_deg(bodies) + 180) % 360, 180, atol=1e-6)


def test_front_share_weighs_by_confidence() -> None:
    assert front_share(np.array([0.0, 180.0]), np.array([0.6, 0.2])) == pytest.approx(0.75)
    assert front_share(np.array([0.0, 180.0]), np.zeros(2)) == pytest.approx(0.5)


def test_headings_to_the_side_agree_and_reflections_do_not() -> None:
    sure = np.array([0.5, 0.5])
    assert heading_shares(np.array([85.0]), np.array([85.0, 95.0]), sure) == pytest.approx(1)
    assert heading_shares(np.array([10.0]), np.array([10.0, 170.0]), sure) == pytest.approx(0.5)
    assert heading_shares(np.array([-170.0]), np.array([175.0, 10.0]), sure) == pytest.approx(0.5)
