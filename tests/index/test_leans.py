"""People who lean: silhouettes turned upright and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH
from index.candidates import find_candidates
from index.keypoint_search import Nearest
from index.leans import (
    FARTHEST_DEG,
    LEANS,
    LEAST_SHARE,
    STEP_DEG,
    Leaning,
    find_leaning_candidates,
    leaning_candidates_of,
    likely_leans,
    turned,
)
from index.skeleton import JOINTS
from index.store import PoseIndex

ANGLES = (-30.0, -15.0, 10.0, 25.0)


def pixels(silhouette: np.ndarray) -> np.ndarray:
    return np.argwhere(silhouette)[:, ::-1].astype(float)


@pytest.mark.parametrize("angle", ANGLES)
class TestTurned:
    def test_the_way_back_leads_to_the_silhouette(self, toy_index: PoseIndex, angle: float) -> None:
        silhouette = toy_index.silhouette(40)
        upright, back = turned(silhouette, angle)
        assert upright.shape == (HEIGHT, WIDTH)
        places = np.rint(pixels(upright) @ back[:, :2].T + back[:, 2]).astype(int)
        inside = np.clip(places, 0, (WIDTH - 1, HEIGHT - 1))
        assert silhouette[inside[:, 1], inside[:, 0]].mean() > 0.95
        assert_allclose(places.mean(axis=0), pixels(silhouette).mean(axis=0), atol=1.0)

    def test_turns_clockwise(self, toy_index: PoseIndex, angle: float) -> None:
        _, back = turned(toy_index.silhouette(40), angle)
        # Back is counterclockwise: what points right on the turned picture pointed up before.
        assert np.rad2deg(np.arctan2(-back[1, 0], back[0, 0])) == pytest.approx(angle, abs=1e-6)

    def test_turning_back_gives_the_silhouette(self, toy_index: PoseIndex, angle: float) -> None:
        silhouette = toy_index.silhouette(40)
        again = turned(turned(silhouette, angle)[0], -angle)[0]
        both, either = (again & silhouette).sum(), (again | silhouette).sum()
        # Turned by 30 degrees it is drawn at two thirds of the size.
        assert both / either > 0.8


def leanings(silhouette: NDArray[np.uint8], *leans_deg: float) -> list[Leaning]:
    return [Leaning.of(silhouette, lean) for lean in leans_deg]


def test_a_leaning_person_is_found(toy_index: PoseIndex) -> None:
    number, lean = 40, 15.0
    leaning, back = turned(toy_index.silhouette(number), lean)
    found = find_leaning_candidates(toy_index, leanings(leaning, -15.0, 0.0, 15.0), 20)
    assert (found.numbers[0], found.lean_deg[0]) == (number, lean)
    entry = toy_index.entry(number)
    expected = (entry.points_normalised[:JOINTS] - back[:, 2]) @ np.linalg.inv(back[:, :2]).T
    assert_allclose(found.points_normalised[0, :JOINTS], expected, atol=2.0)
    # The head is up; leaning clockwise brings it to the right.
    upright = entry.points_3d[4]
    angle = np.rad2deg(np.arctan2(upright[0], -upright[1]))
    x, y, z = found.points_3d[0, 4]
    assert np.rad2deg(np.arctan2(x, -y)) == pytest.approx(angle + lean)
    assert z == pytest.approx(upright[2])


def test_without_a_lean_the_candidates_are_the_same(toy_index: PoseIndex) -> None:
    silhouette = toy_index.silhouette(100)
    ours = find_leaning_candidates(toy_index, leanings(silhouette, 0.0), 30)
    theirs = find_candidates(toy_index, silhouette, 30)
    assert_array_equal(ours.numbers, theirs.numbers)
    assert_array_equal(ours.points_3d, theirs.points_3d)
    assert (ours.lean_deg == 0).all()


def test_all_leans_come_together_in_ascending_distance(toy_index: PoseIndex) -> None:
    some = leanings(toy_index.silhouette(7), -20.0, 0.0, 20.0)
    found = find_leaning_candidates(toy_index, some, 10)
    assert len(found) == 30
    assert (np.diff(found.distances) >= 0).all()
    assert set(found.lean_deg) == {-20.0, 0.0, 20.0}


def test_a_single_pixel_can_be_turned() -> None:
    dot = np.zeros((HEIGHT, WIDTH), np.uint8)
    dot[60, 20] = 1
    assert turned(dot, 33.0)[0].any()


@given(rolls=st.lists(st.floats(-180, 180), min_size=1, max_size=60))
def test_likely_leans_are_few_and_upright_is_among_them(rolls: list[float]) -> None:
    leans = likely_leans(np.array(rolls))
    assert list(leans) == sorted(set(leans))
    assert 0.0 in leans
    assert len(leans) <= LEANS
    steps = np.clip(np.rint(np.array(rolls) / STEP_DEG) * STEP_DEG, -FARTHEST_DEG, FARTHEST_DEG)
    for lean in set(leans) - {0.0}:
        assert (steps == lean).mean() >= LEAST_SHARE
        assert abs(lean) <= FARTHEST_DEG
    # Nobody likelier was left out.
    if len(leans) > 1:
        rarest = min((steps == lean).sum() for lean in set(leans) - {0.0})
        others = {lean for lean in steps.tolist() if lean} - set(leans)
        assert all((steps == lean).sum() <= rarest for lean in others) or len(leans) < LEANS


@pytest.mark.parametrize("lean", [-45.0, -15.0, 30.0, 60.0])
def test_the_lean_that_most_have_is_likely(lean: float) -> None:
    rolls = np.random.default_rng(1).normal(lean, 4, 100)
    assert set(likely_leans(rolls)) >= {0.0, lean}


def test_mirrored_leans_are_as_likely() -> None:
    rolls = np.array([14.0] * 30 + [-31.0] * 20 + [3.0] * 50)
    assert likely_leans(rolls) == (-30.0, 0.0, 15.0)
    assert likely_leans(-rolls) == (-15.0, 0.0, 30.0)


def test_entries_near_keypoints_lean_as_they_do(toy_index: PoseIndex) -> None:
    numbers, lean = np.array([40, 41, 40, 42]), 15.0
    mirrored = np.array([False, False, True, False])
    nearest = Nearest(numbers, mirrored, np.array([13.0, -2.0, 80.0, 8.0]), np.zeros(4))
    silhouette = turned(toy_index.silhouette(40), lean)[0]
    found = leaning_candidates_of(toy_index, leanings(silhouette, 0.0, lean), nearest)
    assert (np.diff(found.distances) >= 0).all()
    assert (found.numbers[0], found.lean_deg[0]) == (40, lean)
    leans = {
        (number, is_mirrored): lean
        for number, is_mirrored, lean in zip(
            found.numbers.tolist(), found.mirrored.tolist(), found.lean_deg.tolist(), strict=True
        )
    }
    assert leans == {(40, False): lean, (41, False): 0.0, (40, True): lean, (42, False): lean}
    # As they would be found by the silhouette.
    (same,) = np.flatnonzero((found.numbers == 41) & ~found.mirrored)
    upright = find_candidates(toy_index, silhouette, 2 * len(toy_index))
    (there,) = np.flatnonzero((upright.numbers == 41) & ~upright.mirrored)
    assert found.distances[same] == pytest.approx(upright.distances[there], abs=0.1)
    assert_allclose(found.points_normalised[same], upright.points_normalised[there])
