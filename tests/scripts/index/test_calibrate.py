"""Fitting and judging the confidence."""

import numpy as np
import pytest

from index.store import PoseIndex
from scripts.index.calibrate import Queries, Trial, expected_calibration_error, run_trial
from scripts.index.simulate import Simulation


def test_calibration_error_is_zero_where_confidence_is_the_share_of_right_answers() -> None:
    confidence = np.repeat([0.25, 0.75], 400)
    right = np.concatenate([np.arange(400) % 4 == 0, np.arange(400) % 4 != 0])
    assert expected_calibration_error(confidence, right) == pytest.approx(0)


@pytest.fixture(scope="module")
def queries(ground_simulation: Simulation) -> Queries:
    return Queries.of(ground_simulation)


@pytest.fixture(scope="module")
def trial(ground_index: PoseIndex, queries: Queries) -> Trial:
    """Every 27th silhouette of the index, asked for."""
    return run_trial(ground_index, queries.take(np.arange(0, len(queries), 27)), n=3)


def test_known_silhouettes_are_answered_as_the_camera_saw_them(
    queries: Queries, trial: Trial
) -> None:
    """Both in the picture that was rolled and in the axes of the camera that was not."""
    roll_deg = queries.roll_deg[::27]
    for rows in (roll_deg == 0, roll_deg != 0):
        assert np.median(trial.error_px[rows, 0]) < 1
        assert np.median(trial.error_m[rows, 0]) < 0.05
        assert trial.right[rows, 0].mean() > 0.95
