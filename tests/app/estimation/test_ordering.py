"""The order of hypotheses, their facing, and confidences by both kinds of evidence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.estimation.poses import (
    HYPOTHESES_PER_OPPOSITE_FACING,
    fused_confidences,
    nearest_of_both_facings,
    order_by_landmarks,
    order_by_silhouette,
)
from index.matching import Hypothesis
from index.skeleton import POINTS, rows

ascending_distances = st.lists(st.floats(0, 5), min_size=1, max_size=12).map(sorted)


def hypothesis_like(distance: float = 1.0, *, front: bool = True, **others: float) -> Hypothesis:
    """A hypothesis; facing the camera, its left is on the right of the picture."""
    points_3d = np.zeros((POINTS, 3))
    for side, sign in (("left", 1), ("right", -1)):
        shoulder, hip = rows(f"{side}_shoulder", f"{side}_hip")
        points_3d[[shoulder, hip], 0] = 0.2 * sign * (1 if front else -1)
        points_3d[shoulder, 1] = -0.5
    return Hypothesis(
        entry_id=0, mirrored=False, silhouette_distance=others.pop("silhouette_distance", distance),
        outline_distance_px=1.0, confidence=others.pop("confidence", 0.5), points_3d=points_3d,
        points_normalised=np.zeros((POINTS, 2)), distance=distance, **others,
    )  # fmt: skip


class TestNearestOfBothFacings:
    @given(
        distances=ascending_distances, n=st.integers(1, 15), seed=st.integers(0, 999),
        front_probability=st.floats(0, 1),
    )  # fmt: skip
    def test_takes_the_nearest_and_as_many_of_the_other_facing_as_it_is_likely(
        self, distances: list[float], n: int, seed: int, front_probability: float
    ) -> None:
        rng = np.random.default_rng(seed)
        shuffled: NDArray[np.float64] = rng.permutation(np.array(distances))
        azimuths = rng.uniform(-180, 180, len(shuffled))
        chosen = nearest_of_both_facings(azimuths, shuffled, n, front_probability)
        assert len(chosen) == len(set(chosen)) == min(n, len(shuffled))
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
        assert nearest_of_both_facings(azimuths, distances, 4, 0.4) == [0, 3, 1, 2]
        assert nearest_of_both_facings(azimuths, distances, 4, 0.9) == [0, 1, 2, 3]

    @given(
        distances=ascending_distances, n=st.integers(1, 15), k=st.integers(1, 15),
        seed=st.integers(0, 999),
    )  # fmt: skip
    def test_first_hypotheses_do_not_depend_on_the_number(
        self, distances: list[float], n: int, k: int, seed: int
    ) -> None:
        azimuths = np.random.default_rng(seed).uniform(-180, 180, len(distances))
        fewer, more = sorted((k, n))
        chosen = nearest_of_both_facings(azimuths, np.array(distances), more, 0.3)
        assert chosen[:fewer] == nearest_of_both_facings(azimuths, np.array(distances), fewer, 0.3)


@given(distances=st.lists(st.floats(0, 1e4), min_size=2, max_size=20).map(sorted))
def test_confidence_falls_with_the_distance(distances: list[float]) -> None:
    confidences = fused_confidences(np.array(distances), np.zeros(len(distances)))
    assert ((confidences >= 0) & (confidences <= 1)).all()
    assert (np.diff(confidences) <= 0).all()


class TestOrderBySilhouette:
    @given(distances=st.lists(st.floats(0, 5), min_size=1, max_size=30))
    def test_order_is_kept_and_distances_ascend(self, distances: list[float]) -> None:
        _, ordered = order_by_silhouette([hypothesis_like(one) for one in distances], 40)
        ascending = [one.distance for one in ordered]
        assert [one.silhouette_distance for one in ordered] == distances
        assert ascending == sorted(ascending) and set(ascending) <= set(distances)
        assert all(one >= own for one, own in zip(ascending, distances, strict=True))

    def test_facing_is_the_share_of_the_confidence(self) -> None:
        both = [
            hypothesis_like(1, confidence=0.6), hypothesis_like(2, front=False, confidence=0.2),
        ]  # fmt: skip
        for n, probability in ((2, 0.75), (1, 1)):
            assert order_by_silhouette(both, n)[0].front_probability == pytest.approx(probability)


class TestOrderByLandmarks:
    def test_fused_distance_decides(self) -> None:
        near = hypothesis_like(0.3, silhouette_distance=0.8)
        far = hypothesis_like(2.0, silhouette_distance=0.5)
        facing, ordered = order_by_landmarks([far, near], 2)
        assert [one.silhouette_distance for one in ordered] == [0.8, 0.5]
        assert [one.distance for one in ordered] == [0.3, 2.0]
        confidences = fused_confidences(np.array([0.3, 2.0]), np.zeros(2))
        assert [one.confidence for one in ordered] == confidences.tolist()
        assert facing.evidence == "image"

    def test_no_hypothesis_is_likelier_right_than_its_heading(self) -> None:
        """Where both facings fit, neither is sure; two headings to the side agree."""
        front, back = hypothesis_like(0.3), hypothesis_like(0.3, front=False)
        alone = order_by_landmarks([front], 1)[1][0].confidence
        assert alone > 0.6
        _, both = order_by_landmarks([front, back], 2)
        assert [one.confidence for one in both] == pytest.approx([0.5, 0.5])

    @given(nearer=st.floats(0.1, 10), farther=st.floats(1.1, 100))
    def test_likelier_hypotheses_decide_the_facing(self, nearer: float, farther: float) -> None:
        front, back = hypothesis_like(nearer), hypothesis_like(nearer * farther, front=False)
        for hypotheses in ([front, back], [back, front]):
            facing, ordered = order_by_landmarks(hypotheses, 2)
            assert ordered[0].points_3d is front.points_3d
            assert facing.front_probability > 0.5

    @given(distances=ascending_distances, n=st.integers(1, 15), seed=st.integers(0, 999))
    def test_distances_ascend(self, distances: list[float], n: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        hypotheses = [hypothesis_like(one, front=bool(rng.integers(2))) for one in distances]
        facing, ordered = order_by_landmarks(hypotheses, n)
        ascending = [one.distance for one in ordered]
        assert len(ordered) == min(n, len(hypotheses))
        assert ascending == sorted(ascending) and ascending[0] == min(distances)
        assert 0 <= facing.front_probability <= 1


@pytest.mark.parametrize("order", [order_by_landmarks, order_by_silhouette])
def test_later_hypotheses_do_not_change_the_facing(order: Callable[..., Any]) -> None:
    first = [hypothesis_like(one, front=one < 2) for one in (1.0, 2.0)]
    later = hypothesis_like(2.0, front=False)
    assert order([*first, later], 3, voters=2)[0] == order(first, 2)[0]
    assert order([*first, later], 3)[0] != order(first, 2)[0]
