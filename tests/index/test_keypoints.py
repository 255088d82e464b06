"""Keypoints compared with skeletons: nearer is likelier, and sides are told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.keypoints import DOUBT, Keypoints
from index.skeleton import LIMBS, POINT_NAMES, POINTS, exchange_sides

ROWS = (*(POINT_NAMES.index(name) for name in LIMBS), POINT_NAMES.index("nose"))
seeds = st.integers(0, 9999)


def skeleton(seed: int) -> NDArray[np.float64]:
    """24 points somewhere in the normalised frame."""
    return np.random.default_rng(seed).uniform((4, 4), (44, 124), (POINTS, 2))


def shown(points: NDArray[np.float64], seed: int = 0) -> Keypoints:
    """Keypoints of unequal scores on the points of a skeleton."""
    scores = np.random.default_rng(seed).uniform(0.2, 1, len(ROWS))
    return Keypoints(ROWS, points[list(ROWS)], scores)


@given(seed=seeds, away=st.floats(0, 80))
def test_nothing_is_likelier_than_the_keypoints_themselves(seed: int, away: float) -> None:
    points = skeleton(seed)
    moved = points + away * np.random.default_rng(seed + 1).normal(size=points.shape)
    agreement = shown(points, seed).compare(np.stack([points, moved]))
    assert agreement.log_likelihood[0] >= agreement.log_likelihood[1]
    assert (agreement.log_likelihood <= 0).all()
    assert agreement.weights().max() == 1


def test_keypoints_that_are_sure_and_met_are_certain() -> None:
    points = skeleton(1)
    sure = replace(shown(points), scores=np.ones(len(ROWS)))
    assert sure.compare(points[None]).log_likelihood == pytest.approx([0])


@given(seed=seeds, near=st.floats(0, 30), farther=st.floats(0.1, 30))
def test_farther_is_less_likely(seed: int, near: float, farther: float) -> None:
    """One point leaves its keypoint; all others stay."""
    points, keypoints = skeleton(seed), shown(skeleton(seed))
    both = np.stack([points, points])
    both[:, ROWS[seed % len(ROWS)], 1] += (near, near + farther)
    own, _ = keypoints._compare_sides(both)
    assert own[1] < own[0]


@given(seed=seeds, other=seeds)
def test_exchanging_the_sides_of_a_skeleton_turns_the_odds_over(seed: int, other: int) -> None:
    points = skeleton(other)
    agreement = shown(skeleton(seed)).compare(np.stack([points, exchange_sides(points)]))
    assert agreement.side_odds[0] == pytest.approx(-agreement.side_odds[1])
    assert agreement.log_likelihood[0] == pytest.approx(agreement.log_likelihood[1])
    if abs(agreement.side_odds[0]) > 1e-9:  # Else either may pull.
        assert_allclose(agreement.pulls[0], agreement.pulls[1])


@given(seed=seeds)
def test_the_skeleton_shown_is_likelier_than_its_twin(seed: int) -> None:
    points = skeleton(seed)
    assert shown(points).compare(points[None]).side_odds[0] > 0


@given(seed=seeds, x=st.floats(-6, 6), y=st.floats(-6, 6))
def test_pulls_lead_towards_the_keypoints_and_never_past_them(
    seed: int, x: float, y: float
) -> None:
    points = skeleton(seed)
    (pulls,) = shown(points).compare(points[None] - (x, y)).pulls
    assert pulls.shape == (len(ROWS), 2)
    wanted = np.broadcast_to([x, y], pulls.shape)
    assert (pulls * wanted >= 0).all()
    assert (np.abs(pulls) <= np.abs(wanted) + 1e-12).all()
    # So near, they lead most of the way.
    assert_allclose(pulls, wanted, atol=0.4 * np.hypot(x, y) + 1e-9)


def test_pulls_vanish_where_a_point_is_too_far_to_be_meant() -> None:
    points = skeleton(3)
    far = points.copy()
    far[ROWS[0]] += 90
    (pulls,) = shown(points).compare(far[None]).pulls
    assert np.abs(pulls[0]).max() < 1e-3


@given(seed=seeds, row=st.integers(0, len(ROWS) - 1))
def test_one_keypoint_that_misleads_rules_nothing_out(seed: int, row: int) -> None:
    points = skeleton(seed)
    keypoints = shown(points)
    keypoints.positions[row] += 500
    lost = (
        shown(points).compare(points[None]).log_likelihood
        - keypoints.compare(points[None]).log_likelihood
    )
    assert 0 < lost[0] <= np.log((1 + DOUBT) / DOUBT) + 1e-9


@given(seed=seeds)
def test_what_is_less_sure_tells_less(seed: int) -> None:
    points = skeleton(seed)
    both = np.stack([points, points + 9])
    sure = shown(points)
    unsure = replace(sure, scores=sure.scores / 4)
    spans = [np.ptp(one._compare_sides(both)[0]) for one in (sure, unsure)]
    assert spans[1] < spans[0]


def test_some_can_be_taken() -> None:
    keypoints = shown(skeleton(0))
    points = np.stack([skeleton(seed) for seed in range(5)])
    rows = np.array([3, 1])
    some, alone = keypoints.compare(points).take(rows), keypoints.compare(points[rows])
    assert_array_equal(some.log_likelihood, alone.log_likelihood)
    assert_array_equal(some.side_odds, alone.side_odds)
    assert_array_equal(some.pulls, alone.pulls)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"positions": np.zeros((12, 2))}, "expected positions of shape"),
        ({"scores": np.ones(12)}, "expected positions of shape"),
        ({"rows": (*ROWS[:-1], POINTS)}, "expected rows from 0 to 23"),
        ({"rows": (), "positions": np.zeros((0, 2)), "scores": np.zeros(0)}, "expected rows"),
        ({"scores": np.zeros(len(ROWS))}, "expected scores above 0"),
        ({"scores": np.full(len(ROWS), 1.1)}, "expected scores above 0"),
        ({"scores": np.full(len(ROWS), np.nan)}, "expected scores above 0"),
    ],
)
def test_what_makes_no_sense_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(shown(skeleton(0)), **change)
