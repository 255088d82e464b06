"""Views: within their ranges, around the body, crowding towards eye level."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scripts.index.views import DISTANCES_M, ELEVATIONS_DEG, GROUND_ELEVATIONS_DEG, sample_views


@pytest.mark.parametrize("elevations_deg", [ELEVATIONS_DEG, GROUND_ELEVATIONS_DEG])
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40))
def test_within_the_documented_ranges(
    elevations_deg: tuple[float, float], seed: int, count: int
) -> None:
    views = sample_views(count, np.random.default_rng(seed), elevations_deg)
    assert len(views) == count
    assert ((views["azimuth_deg"] >= 0) & (views["azimuth_deg"] <= 360)).all()
    low, high = elevations_deg
    assert ((views["elevation_deg"] >= low) & (views["elevation_deg"] <= high)).all()
    near, far = DISTANCES_M
    inside = (views["distance"] >= near * 0.999) & (views["distance"] <= far * 1.001)
    assert inside.all()
