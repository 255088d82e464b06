"""Entries nearest to landmarks: the same as by comparing with each of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from index.search import (
    DIMENSION,
    SEARCHED,
    STEPS_PER_BODY,
    LandmarkSearch,
    body_sizes,
    mirrored_limbs,
    pose_vectors,
    rotate_clockwise,
)
from index.skeleton import LIMBS, mirror_3d
from index.store import PoseIndex

ROLLS = (0.0, 35.0, -120.0)
STEP = 1 / STEPS_PER_BODY
"""Coordinates are whole numbers of this share of a body's size."""


def some_limbs(seed: int, count: int = 1) -> NDArray[np.float64]:
    """Limbs ``(count, 12, 3)`` of people of about 1.7 m, anywhere."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 0.4, (count, 12, 3)) + rng.normal(0, 3, (count, 1, 3))


def upright_limbs(index: PoseIndex) -> NDArray[np.float64]:
    """Limbs ``(E, 12, 3)`` of all entries, as cameras that are not rolled see them."""
    points = index.points(np.arange(len(index)))[0][:, list(SEARCHED)]
    rolls = index.roll_deg(np.arange(len(index)), np.zeros(len(index), bool))
    return np.stack(
        [rotate_clockwise(one, -roll) for one, roll in zip(points, rolls.tolist(), strict=True)]
    )


def normalised(limbs: NDArray[np.float64]) -> NDArray[np.float64]:
    """About the hips, in sizes of the body, as exactly as floats are."""
    hips = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
    return (limbs - limbs[:, hips].mean(axis=1, keepdims=True)) / body_sizes(limbs)[:, None, None]


def brute_force(
    limbs: NDArray[np.float64], asked: NDArray[np.float64], rolls_deg: tuple[float, ...]
) -> NDArray[np.float64]:
    """Root mean square joint distances ``(R, 2, E)``, straight and mirrored, one by one."""
    found = np.empty((len(rolls_deg), 2, len(limbs)))
    stored = normalised(limbs)
    for row, roll in enumerate(rolls_deg):
        turned = rotate_clockwise(asked, -roll)
        for column, variant in enumerate((turned, mirrored_limbs(turned))):
            offsets = stored - normalised(variant[None])
            found[row, column] = np.sqrt((offsets**2).sum(axis=-1).mean(axis=-1))
    return found


@pytest.mark.parametrize("number", [5, 130, 400])
@pytest.mark.parametrize("rolls_deg", [(0.0,), ROLLS])
def test_equals_comparing_with_each(
    toy_index: PoseIndex, number: int, rolls_deg: tuple[float, ...]
) -> None:
    limbs = upright_limbs(toy_index)
    rng = np.random.default_rng(number)
    asked = 1.3 * rotate_clockwise(limbs[number] + rng.normal(0, 0.05, (12, 3)), 20) + (1, 2, 3)
    k = 40
    found = toy_index.landmark_search.nearest(asked, rolls_deg, k)
    expected = brute_force(limbs, asked, rolls_deg)
    # Each coordinate is rounded to a step, in both.
    assert_allclose(found.distances, np.sort(expected.ravel())[:k], atol=2 * STEP)
    row = np.array([rolls_deg.index(roll) for roll in found.roll_deg.tolist()])
    own = expected[row, found.mirrored.astype(int), found.numbers]
    assert_allclose(found.distances, own, atol=2 * STEP)
    assert (np.diff(found.distances) >= 0).all()


@pytest.mark.parametrize("mirrored", [False, True])
def test_entries_rolled_to_stand_are_searched_as_they_lie(
    ground_index: PoseIndex, mirrored: bool
) -> None:
    limbs = upright_limbs(ground_index)
    for number in np.flatnonzero(np.abs(ground_index.entries["roll_deg"]) > 30)[::40].tolist():
        asked = mirrored_limbs(limbs[number]) if mirrored else limbs[number]
        found = ground_index.landmark_search.nearest(asked, (0.0,), 3)
        assert found.distances[0] < 2 * STEP
        same = (found.numbers == number) & (found.mirrored == mirrored)
        assert found.distances[same] == pytest.approx(found.distances[0], abs=2 * STEP)


@given(seed=st.integers(0, 9999), roll=st.floats(-180, 180))
def test_the_mirror_image_of_a_person_has_mirrored_answers(seed: int, roll: float) -> None:
    limbs = some_limbs(seed, 30)
    search = LandmarkSearch(pose_vectors(limbs))
    asked = some_limbs(seed + 1)[0]
    here = search.nearest(asked, (0.0, roll), 60)
    there = search.nearest(mirrored_limbs(asked), (0.0, -roll), 60)
    # Half steps round to even numbers, whatever their sign; floats of turned points may not.
    assert_allclose(there.distances, here.distances, atol=STEP)


@given(seed=st.integers(0, 9999), scale=st.floats(0.1, 9), x=st.floats(-50, 50))
def test_where_and_how_large_somebody_is_does_not_matter(seed: int, scale: float, x: float) -> None:
    limbs = some_limbs(seed)
    assert_allclose(pose_vectors(scale * limbs + x), pose_vectors(limbs), atol=1)
    assert_allclose(body_sizes(scale * limbs + x), scale * body_sizes(limbs), rtol=1e-6)


@given(seed=st.integers(0, 9999))
def test_vectors_are_whole_numbers_of_a_byte(seed: int) -> None:
    vectors = pose_vectors(some_limbs(seed, 5))
    assert vectors.shape == (5, DIMENSION)
    assert (vectors == np.rint(vectors)).all() and np.abs(vectors).max() <= 127
    assert (vectors[:, 3 * len(LIMBS) :] == 0).all()
    assert pose_vectors(np.zeros((1, 12, 3))).tolist() == np.zeros((1, DIMENSION)).tolist()


def test_mirroring_is_that_of_skeletons(toy_index: PoseIndex) -> None:
    points = toy_index.points(np.arange(9))[0]
    rows = list(SEARCHED)
    for one, mirrored in zip(points, mirror_3d(points), strict=True):
        assert_allclose(mirrored_limbs(one[rows]), mirrored[rows], atol=1e-9)
        assert_allclose(mirrored_limbs(mirrored_limbs(one[rows])), one[rows])


def test_no_more_than_all_entries(toy_index: PoseIndex) -> None:
    asked = upright_limbs(toy_index)[7]
    search = toy_index.landmark_search
    found = search.nearest(asked, (0.0, 40.0), 10**6)
    assert len(search) == len(toy_index) == len(found.numbers)
    triples = zip(found.numbers.tolist(), found.mirrored.tolist(), found.roll_deg.tolist(),
                  strict=True)  # fmt: skip
    assert len(set(triples)) == len(found.numbers)
    fewer = search.nearest(asked, (0.0, 40.0), 20)
    assert_array_equal(fewer.numbers, found.numbers[:20])
    assert_array_equal(fewer.distances, found.distances[:20])


@pytest.mark.parametrize("shape", [(4, 36), (4, 12, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected vectors of shape \(E, 48\)"):
        LandmarkSearch(np.zeros(shape, np.float32))
