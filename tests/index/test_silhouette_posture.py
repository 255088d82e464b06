"""Postures read from silhouettes: shares, and what votes may change."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.network import HIDDEN, QUANT_MAX, RankingModel, posture_inputs
from index.posture import POSTURES, SILHOUETTE_GROUPS, UPRIGHT, PostureName, vote_posture
from index.silhouette_matching import match_silhouette
from index.store import PoseIndex
from tests.index.helpers import random_postures

NETWORK = random_postures(0)
seeds = st.integers(0, 2**32 - 1)
some_votes = st.lists(st.floats(0.001, 1), min_size=len(POSTURES), max_size=len(POSTURES)).map(
    lambda weights: vote_posture(POSTURES, weights)
)


def hidden(seed: int) -> NDArray[np.float32]:
    values = np.random.default_rng(seed).integers(0, QUANT_MAX + 1, HIDDEN)
    return values.astype(np.float32)


def share(shares: NDArray[np.float64], *postures: PostureName) -> float:
    return float(sum(shares[POSTURES.index(name)] for name in postures))


@given(seed=seeds, votes=some_votes, roll_deg=st.floats(-180, 180))
def test_votes_divide_who_is_upright_and_shares_sum_to_one(
    seed: int, votes: NDArray[np.float64], roll_deg: float
) -> None:
    shares = NETWORK.shares(hidden(seed), roll_deg, votes)
    assert shares.sum() == pytest.approx(1)
    upright = share(shares, *UPRIGHT)
    for name in UPRIGHT:
        # A posture without votes counts as a thousandth.
        within = (share(votes, name) + 1e-3) / (share(votes, *UPRIGHT) + 1e-3 * len(UPRIGHT))
        assert share(shares, name) == pytest.approx(upright * within, abs=1e-6)


@given(seed=seeds, votes=some_votes)
def test_more_votes_make_a_posture_likelier(seed: int, votes: NDArray[np.float64]) -> None:
    more = votes + np.array([name == "kneeling" for name in POSTURES])
    before, after = (
        NETWORK.shares(hidden(seed), 0.0, one) for one in (votes, np.asarray(more / more.sum()))
    )
    assert share(after, "kneeling") > share(before, "kneeling")
    silent = replace(NETWORK, vote_weight=0.0)
    kinds = [SILHOUETTE_GROUPS.sums(silent.shares(hidden(seed), 0.0, one)) for one in (votes, more)]
    assert_allclose(*kinds, atol=1e-6)


@given(roll_deg=st.floats(1, 90))
def test_either_end_and_either_side_may_be_up(roll_deg: float) -> None:
    given = posture_inputs(hidden(1), roll_deg)
    assert given.min() >= 0 and given.max() <= QUANT_MAX
    for same in (-roll_deg, 180 - roll_deg, roll_deg - 180):
        assert_allclose(posture_inputs(hidden(1), same), given, atol=1)
    assert (posture_inputs(hidden(1), 0.0)[HIDDEN:] == 0).all()


def test_a_mirror_image_is_in_the_same_posture(
    toy_index: PoseIndex, reranker: RankingModel
) -> None:
    index = replace(toy_index, reranker=replace(reranker, postures=NETWORK))
    # One without ties among the modes, which the last digits would decide.
    silhouette = toy_index.silhouette(6)
    one, mirrored = (
        match_silhouette(index, np.ascontiguousarray(seen), 3).postures
        for seen in (silhouette, silhouette[:, ::-1])
    )
    # Searches and sums of candidates differ in the last digits, the network does not.
    assert_allclose(one, mirrored, atol=0.01)
    ours, theirs = (reranker.network.read(s).hidden for s in (silhouette, silhouette[:, ::-1]))
    assert_array_equal(ours, theirs)
    plain = match_silhouette(toy_index, silhouette, 3)
    assert not np.allclose(plain.postures, one)
