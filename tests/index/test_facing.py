"""Which way skeletons face, and the choice among hypotheses that face either way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from index.posture import (
    HYPOTHESES_PER_OPPOSITE_FACING,
    azimuth_deg,
    front_share,
    likeliest_of_both_facings,
)
from index.skeleton import POINTS, camera_rotation, side_rows, wrap_degrees


@pytest.mark.parametrize("azimuth", [-170.0, -90.0, -30.0, 0.0, 45.0, 90.0, 179.0])
# From above, depth is foreshortened.
@pytest.mark.parametrize(("elevation", "atol"), [(0.0, 1e-9), (30.0, 5.0)])
def test_azimuth_is_that_of_the_camera(azimuth: float, elevation: float, atol: float) -> None:
    body = np.zeros((POINTS, 3))
    body[side_rows("shoulder", "hip"), 0] = 0.2, -0.2, 0.2, -0.2
    body[side_rows("shoulder"), 1] = 0.5
    seen = azimuth_deg(body @ camera_rotation(azimuth, elevation).T)
    assert wrap_degrees(seen - azimuth) == pytest.approx(0, abs=atol)


def test_front_share_weighs_by_confidence() -> None:
    assert front_share(np.array([0.0, 180.0]), np.array([0.6, 0.2])) == pytest.approx(0.75)
    assert front_share(np.array([0.0, 180.0]), np.zeros(2)) == pytest.approx(0.5)


class TestLikeliestOfBothFacings:
    @given(
        confidences=st.lists(st.floats(0, 1), min_size=1, max_size=15), count=st.integers(1, 12),
        seed=st.integers(0, 999), front_probability=st.floats(0, 1),
    )  # fmt: skip
    def test_takes_the_likeliest_and_as_many_of_the_other_facing_as_it_is_likely(
        self, confidences: list[float], count: int, seed: int, front_probability: float
    ) -> None:
        some = np.array(confidences)
        azimuths = np.random.default_rng(seed).uniform(-180, 180, len(some))
        chosen = likeliest_of_both_facings(azimuths, some, front_probability, count)
        assert len(chosen) == len(set(chosen)) == min(count, len(some))
        assert some[chosen[0]] == some.max()
        assert (np.diff(some[chosen]) <= 0).all()
        front = np.cos(np.deg2rad(azimuths)) > 0
        opposite = front != front[chosen[0]]
        for facing in (opposite, ~opposite):
            of_it = sorted(some[[i for i in chosen if facing[i]]])
            assert of_it == sorted(some[facing])[len(some[facing]) - len(of_it) :]
        likely = 1 - front_probability if front[chosen[0]] else front_probability
        share = max(likely, 1 / HYPOTHESES_PER_OPPOSITE_FACING)
        due = min(int(share * count + 1e-9), opposite.sum(), count - 1)
        assert opposite[chosen].sum() >= due

    def test_the_other_facing_is_among_seven_however_unlikely(self) -> None:
        azimuths, confidences = np.zeros(9), np.linspace(0.9, 0.1, 9)
        azimuths[8] = 180.0
        assert likeliest_of_both_facings(azimuths, confidences, 1.0, 7) == [0, 1, 2, 3, 4, 5, 8]
