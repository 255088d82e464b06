"""Which way skeletons face, and the choice among hypotheses that face either way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from index.facing import (
    HYPOTHESES_PER_OPPOSITE_FACING,
    azimuth_deg,
    front_share,
    heading_shares,
    nearest_of_both_facings,
)
from index.skeleton import POINTS, camera_rotation, side_rows, wrap_degrees

ascending_distances = st.lists(st.floats(0, 5), min_size=1, max_size=12).map(sorted)


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


def test_headings_to_the_side_agree_and_reflections_do_not() -> None:
    sure = np.array([0.5, 0.5])
    assert heading_shares(np.array([85.0]), np.array([85.0, 95.0]), sure) == pytest.approx(1)
    assert heading_shares(np.array([10.0]), np.array([10.0, 170.0]), sure) == pytest.approx(0.5)
    assert heading_shares(np.array([-170.0]), np.array([175.0, 10.0]), sure) == pytest.approx(0.5)


class TestNearestOfBothFacings:
    @given(
        distances=ascending_distances, n=st.integers(1, 12), seed=st.integers(0, 999),
        front_probability=st.floats(0, 1),
    )  # fmt: skip
    def test_takes_the_nearest_and_as_many_of_the_other_facing_as_it_is_likely(
        self, distances: list[float], n: int, seed: int, front_probability: float
    ) -> None:
        rng = np.random.default_rng(seed)
        shuffled: NDArray[np.float64] = rng.permutation(np.array(distances))
        azimuths, n = rng.uniform(-180, 180, len(shuffled)), min(n, len(shuffled))
        chosen = nearest_of_both_facings(azimuths, shuffled, front_probability, [len(shuffled)] * n)
        assert len(chosen) == len(set(chosen)) == n
        assert shuffled[chosen[0]] == shuffled.min()
        front = np.cos(np.deg2rad(azimuths)) > 0
        opposite = front != front[chosen[0]]
        for facing in (opposite, ~opposite):
            of_it = [i for i in chosen if facing[i]]
            assert shuffled[of_it].tolist() == sorted(shuffled[facing])[: len(of_it)]
        likely = 1 - front_probability if front[chosen[0]] else front_probability
        share = max(likely, 1 / HYPOTHESES_PER_OPPOSITE_FACING)
        for rank, i in enumerate(chosen, start=1):
            due = min(int(share * rank + 1e-9), opposite.sum(), rank - 1)
            assert opposite[chosen[:rank]].sum() >= due
            nearer = set(range(len(shuffled))) - set(chosen[:rank])
            forced = opposite[i] and opposite[chosen[: rank - 1]].sum() < int(share * rank + 1e-9)
            assert forced or all(shuffled[i] <= shuffled[j] for j in nearer)

    def test_the_other_facing_is_second_where_it_is_likelier(self) -> None:
        azimuths = np.array([0.0, 5.0, 10.0, 180.0])
        distances = np.array([1.0, 1.1, 1.2, 1.3])
        assert nearest_of_both_facings(azimuths, distances, 0.4, [4] * 4) == [0, 3, 1, 2]
        assert nearest_of_both_facings(azimuths, distances, 0.9, [4] * 4) == [0, 1, 2, 3]

    def test_first_ranks_are_chosen_among_the_first_rows(self) -> None:
        """Later rows do not change what was chosen without them."""
        azimuths, distances = np.array([0.0, 5.0, 10.0, 180.0]), np.ones(4)
        assert nearest_of_both_facings(azimuths, distances, 0.4, [3, 3, 4, 4]) == [0, 1, 3, 2]
