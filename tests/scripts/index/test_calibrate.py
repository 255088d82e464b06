"""Fitting and judging the confidence."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from index.skeleton import JOINTS, camera_rotation
from index.store import PoseIndex
from scripts.index.calibrate import Queries, Trial, expected_calibration_error, run_trial
from scripts.index.simulate import Simulation
from scripts.index.views import MAX_OWN_ROLL_DEG


def test_calibration_error_is_zero_where_confidence_is_the_share_of_right_answers() -> None:
    confidence = np.repeat([0.25, 0.75], 400)
    right = np.concatenate([np.arange(400) % 4 == 0, np.arange(400) % 4 != 0])
    assert expected_calibration_error(confidence, right) == pytest.approx(0)


@pytest.fixture(scope="module")
def queries(ground_simulation: Simulation) -> Queries:
    return Queries.of(ground_simulation)


@pytest.fixture(scope="module")
def trial(ground_index: PoseIndex, queries: Queries) -> Trial:
    """Every ninth silhouette of the index, asked for."""
    return run_trial(ground_index, queries.take(np.arange(0, len(queries), 9)), n=3)


def test_queries_of_wide_bodies_have_the_roll_of_their_camera(
    ground_simulation: Simulation, queries: Queries
) -> None:
    roll_deg = ground_simulation.entries["roll_deg"]
    stood_up = np.abs(roll_deg) > MAX_OWN_ROLL_DEG
    assert 0.2 < stood_up.mean() < 0.8
    assert_array_equal(queries.roll_deg, np.where(stood_up, roll_deg, 0))
    # A camera's own roll of a few degrees is nobody's to know.
    assert (roll_deg[~stood_up] != 0).all()


def test_truth_is_what_a_camera_sees_that_is_not_rolled(
    ground_simulation: Simulation, queries: Queries
) -> None:
    entries = ground_simulation.entries
    own_roll = np.where(queries.roll_deg == 0, entries["roll_deg"], 0)
    cameras = camera_rotation(entries["azimuth_deg"], entries["elevation_deg"], own_roll)
    bodies = ground_simulation.skeletons[entries["skeleton"], :JOINTS].astype(np.float64)
    assert_allclose(queries.joints_3d, bodies @ cameras.swapaxes(1, 2), atol=1e-5)


def test_known_silhouettes_are_answered_as_the_camera_saw_them(
    queries: Queries, trial: Trial
) -> None:
    """Both in the picture that was rolled and in the axes of the camera that was not."""
    roll_deg = queries.roll_deg[::9]
    for rows in (roll_deg == 0, roll_deg != 0):
        assert np.median(trial.error_px[rows, 0]) < 1
        assert np.median(trial.error_m[rows, 0]) < 0.05
        assert trial.right[rows, 0].mean() > 0.95
