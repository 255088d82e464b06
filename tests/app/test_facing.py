"""Which way skeletons face."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.estimation.facing import azimuth_deg
from index.landmark_search import rotate_clockwise
from index.skeleton import camera_rotation


@pytest.mark.parametrize("azimuth", [-170.0, -90.0, -30.0, 0.0, 45.0, 90.0, 179.0])
# From above, depth is foreshortened.
@pytest.mark.parametrize(("elevation", "atol"), [(0.0, 1e-9), (30.0, 5.0)])
def test_azimuth_is_that_of_the_camera(azimuth: float, elevation: float, atol: float) -> None:
    body = np.zeros((24, 3))
    body[[5, 11], 0], body[[8, 15], 0] = 0.2, -0.2  # shoulders and hips, to the left and right
    body[[5, 8], 1] = 0.5
    seen = azimuth_deg(body @ camera_rotation(azimuth, elevation).T)
    assert (seen - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=atol)


@pytest.mark.parametrize("angle", [-135.0, -90.0, 15.0, 90.0, 180.0])
def test_azimuth_does_not_change_as_the_picture_is_rotated(angle: float) -> None:
    bodies = np.random.default_rng(0).normal(size=(20, 24, 3))
    rotated = azimuth_deg(rotate_clockwise(bodies, angle))
    assert_allclose((rotated - azimuth_deg(bodies) + 180) % 360, 180, atol=1e-6)
