"""Maps of joints: likeliest at their peaks, pulling there, and never ruling a pose out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy import ndimage

from index.joint_maps import DOUBT, JointMaps
from index.skeleton import POINTS, exchange_sides

ROWS = (4, 7, 10)
SHAPE = (36, 24)
SCALE, OFFSET = 0.25, np.array([2.0, 1.5])
PEAKS = np.array([[20.0, 30.0], [40.0, 80.0], [12.0, 60.0]])


def maps_about(peaks: NDArray[np.float64], spread_cells: float = 0.6) -> JointMaps:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cells = peaks * SCALE + OFFSET
    maps = np.stack(
        [np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * spread_cells**2)) for cx, cy in cells]
    )
    maps /= maps.sum(axis=(1, 2), keepdims=True)
    return JointMaps(ROWS, maps.astype(np.float32), SCALE, OFFSET)


def skeleton(places: NDArray[np.float64]) -> NDArray[np.float64]:
    points = np.zeros((1, POINTS, 2))
    points[0, list(ROWS)] = places
    return points


def test_a_skeleton_at_the_peaks_is_likeliest() -> None:
    maps = maps_about(PEAKS)
    at_peaks = maps.look(skeleton(PEAKS)).log_likelihood[0]
    rng = np.random.default_rng(0)
    for _ in range(50):
        away = PEAKS + rng.normal(0, 8, PEAKS.shape)
        assert maps.look(skeleton(away)).log_likelihood[0] <= at_peaks + 1e-6
    assert at_peaks <= 0


def test_likelihood_falls_as_a_point_moves_away() -> None:
    maps = maps_about(PEAKS)
    steps = [maps.look(skeleton(PEAKS + [[d, 0]] * 3)).log_likelihood[0] for d in range(0, 20, 4)]
    assert (np.diff(steps) < 0).all()


def test_between_cells_maps_are_interpolated() -> None:
    maps = maps_about(PEAKS, spread_cells=2.0)
    far = np.full((3, 2), 1e6)
    nowhere = maps.look(skeleton(far)).log_likelihood[0] / 3
    rng = np.random.default_rng(0)
    for row in range(3):
        smooth = ndimage.gaussian_filter(
            maps.maps[row].astype(np.float64), maps.spread_cells, mode="constant"
        )
        for _ in range(20):
            places = far.copy()
            places[row] = PEAKS[row] + rng.normal(0, 4, 2)
            cell = (SCALE * places[row] + OFFSET)[::-1, None]
            mass = ndimage.map_coordinates(smooth, cell, order=1)[0]
            mass *= 2 * np.pi * maps.spread_cells**2
            expected = np.log((mass + DOUBT) / (1 + DOUBT)) + 2 * nowhere
            assert_allclose(maps.look(skeleton(places)).log_likelihood[0], expected, atol=0.03)


def test_one_bad_point_costs_no_more_than_the_doubt() -> None:
    maps = maps_about(PEAKS)
    moved = PEAKS.copy()
    moved[1] = (3.0, 3.0)
    looks = [maps.look(skeleton(p)).log_likelihood[0] for p in (PEAKS, moved)]
    assert 0 < looks[0] - looks[1] <= np.log((1 + DOUBT) / DOUBT) + 1e-6


def test_points_are_pulled_to_the_probability_about_them() -> None:
    maps = maps_about(PEAKS)
    here = PEAKS + [[3.0, -2.0]] * 3
    pulls = maps.look(skeleton(here)).pulls[0]
    towards = PEAKS - here
    assert ((pulls * towards).sum(axis=1) > 0).all()
    assert (np.linalg.norm(here + pulls - PEAKS, axis=1) < np.linalg.norm(towards, axis=1)).all()
    assert_allclose(maps.look(skeleton(PEAKS)).pulls[0], 0, atol=0.05)


def test_nothing_pulls_where_there_is_no_probability() -> None:
    pulls = maps_about(PEAKS).look(skeleton(np.full((3, 2), 80.0))).pulls[0]
    assert_allclose(pulls, 0, atol=1e-3)


def test_a_map_that_knows_nothing_prefers_nothing() -> None:
    flat = np.full((3, *SHAPE), 1 / (SHAPE[0] * SHAPE[1]), np.float32)
    maps = JointMaps(ROWS, flat, SCALE, OFFSET)
    # Away from the border, where some of the surroundings lie outside.
    looks = [maps.look(skeleton(PEAKS + d)).log_likelihood[0] for d in (0.0, 3.0, 6.0)]
    assert_allclose(looks, looks[0], atol=1e-3)


def test_points_far_outside_count_as_at_the_border() -> None:
    look = maps_about(PEAKS).look(skeleton(np.array([[1e6, -1e6], [-1e6, 0], [0, 1e6]])))
    assert np.isfinite(look.log_likelihood).all()
    assert np.isfinite(look.pulls).all()


def test_weights_are_1_for_the_likeliest() -> None:
    points = np.concatenate([skeleton(PEAKS + d) for d in (5.0, 0.0, 9.0)])
    weights = maps_about(PEAKS).look(points).weights()
    assert weights.argmax() == 1
    assert weights.max() == 1
    assert (weights > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"maps": np.zeros((2, 4, 4), np.float32)}, "expected 3 maps"),
        ({"offset": np.zeros(3)}, "offset of shape"),
        ({"scale": 0.0}, "positive scale"),
        ({"rows": (1, 2, 99)}, "rows from 0 to 23"),
    ],
)
def test_unsound_maps_are_refused(change: dict[str, Any], message: str) -> None:
    sound: dict[str, Any] = {
        "rows": ROWS,
        "maps": np.zeros((3, *SHAPE), np.float32),
        "scale": SCALE,
        "offset": OFFSET,
    }
    with pytest.raises(ValueError, match=message):
        JointMaps(**{**sound, **change})


def test_a_twin_is_as_likely_but_for_its_sides() -> None:
    points = skeleton(PEAKS)
    maps = maps_about(PEAKS)
    own, twin = maps.look(points), maps.look(exchange_sides(points))
    assert_allclose(own.log_likelihood, twin.log_likelihood)
    assert_allclose(own.side_odds, -twin.side_odds)
    assert own.side_odds[0] > 1
    assert_allclose(own.pulls, twin.pulls)
