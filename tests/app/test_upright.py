"""People set upright, as they are matched, and the way back to the frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.upright import UprightPerson
from app.vision.people import COCO_NAMES, ObservedKeypoints, Silhouette, silhouette_from_mask
from app.vision.turning import turned_keypoints, turned_shape, turned_silhouette
from index.keypoints import Keypoints
from index.skeleton import LIMBS, POINT_NAMES

SHAPE = (200, 300)
TURNS = pytest.mark.parametrize("turns", range(4))


def standing() -> Silhouette:
    """Somebody with one arm out, so that every turn of it looks different."""
    mask = np.zeros(SHAPE, bool)
    mask[30:150, 100:130] = True
    mask[60:70, 130:155] = True
    silhouette = silhouette_from_mask(mask, segmenter="mask", truncated=False)
    assert silhouette is not None
    return silhouette


def seen(scores: float | NDArray[np.float64] = 0.5) -> ObservedKeypoints:
    places = np.random.default_rng(0).uniform((100, 30), (155, 150), (17, 2))
    return ObservedKeypoints(places, np.broadcast_to(scores, 17).astype(np.float64))


def person(turns: int, observed: ObservedKeypoints | None = None) -> UprightPerson:
    """`standing` in a frame turned so that it takes so many turns to set them upright."""
    shape = turned_shape(SHAPE, -turns)
    lying = turned_silhouette(standing(), SHAPE, -turns)
    keypoints = observed and turned_keypoints(observed, SHAPE, -turns)
    return UprightPerson.of(lying, turns, shape, keypoints)


@TURNS
def test_whichever_way_they_lie_the_same_person_is_matched(turns: int) -> None:
    upright, turned = person(0, seen()), person(turns, seen())
    assert_array_equal(turned.normalised, upright.normalised)
    ours, theirs = turned.keypoints(), upright.keypoints()
    assert ours is not None and theirs is not None
    assert ours.rows == theirs.rows
    assert_allclose(ours.positions, theirs.positions, atol=1e-9)
    assert_array_equal(ours.scores, theirs.scores)


@TURNS
def test_from_the_frame_to_the_normalised_one_and_back(turns: int) -> None:
    upright = person(turns, seen())
    keypoints = upright.keypoints()
    assert keypoints is not None
    expected = turned_keypoints(seen(), SHAPE, -turns).positions
    rows = [COCO_NAMES.index(POINT_NAMES[row]) for row in keypoints.rows]
    assert_allclose(upright.points_in_frame(keypoints.positions), expected[rows], atol=1e-9)


@TURNS
@given(x=st.floats(-50, 100), y=st.floats(-50, 200))
def test_points_of_the_normalised_frame_turn_with_the_frame(turns: int, x: float, y: float) -> None:
    points = np.array([[x, y], [0.0, 0.0]])
    upright = ObservedKeypoints(np.resize(person(0).points_in_frame(points), (17, 2)), np.ones(17))
    turned = turned_keypoints(upright, SHAPE, -turns).positions[:2]
    assert_allclose(person(turns).points_in_frame(points), turned, atol=1e-9)


@TURNS
def test_pixels_of_the_silhouette_lie_on_it_in_the_frame(turns: int) -> None:
    upright = person(turns)
    pixels = np.argwhere(upright.normalised)[:, ::-1].astype(float)
    x, y = np.rint(upright.points_in_frame(pixels)).astype(int).T
    mask = turned_silhouette(standing(), SHAPE, -turns).mask(turned_shape(SHAPE, -turns))
    height, width = mask.shape
    inside = mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    assert inside.mean() > 0.98


def test_limbs_and_nose_are_compared_and_what_is_not_seen_is_not() -> None:
    keypoints = person(0, seen()).keypoints()
    assert keypoints is not None
    assert {POINT_NAMES[row] for row in keypoints.rows} == {*LIMBS, "nose"}
    scores = np.full(17, 0.9)
    scores[COCO_NAMES.index("left_wrist")] = 0.01
    fewer = person(0, seen(scores)).keypoints()
    assert fewer is not None
    assert {POINT_NAMES[row] for row in fewer.rows} == {*LIMBS, "nose"} - {"left_wrist"}
    place = {POINT_NAMES[row]: p for row, p in zip(fewer.rows, fewer.positions, strict=True)}
    all_of_them: Keypoints = keypoints
    for row, position in zip(all_of_them.rows, all_of_them.positions, strict=True):
        if POINT_NAMES[row] in place:
            assert_allclose(place[POINT_NAMES[row]], position)


@pytest.mark.parametrize("visible", [0, 3])
def test_a_few_keypoints_are_none(visible: int) -> None:
    scores = np.zeros(17)
    scores[5 : 5 + visible] = 0.9
    assert person(0, seen(scores)).keypoints() is None
    # The face tells nothing that an index could be compared with.
    scores[1:5] = 0.9
    assert person(0, seen(scores)).keypoints() is None
    assert person(0).keypoints() is None
