"""Fitting and judging the confidence."""

from __future__ import annotations

import numpy as np
import pytest

from index.build.calibrate import expected_calibration_error


def test_calibration_error_is_zero_where_confidence_is_the_share_of_right_answers() -> None:
    confidence = np.repeat([0.25, 0.75], 400)
    right = np.concatenate([np.arange(400) % 4 == 0, np.arange(400) % 4 != 0])
    assert expected_calibration_error(confidence, right) == pytest.approx(0)


def test_calibration_error_of_the_overconfident() -> None:
    # Always sure, right half of the time.
    right = np.arange(100) % 2 == 0
    assert expected_calibration_error(np.ones(100), right) == pytest.approx(0.5)


def test_calibration_error_weighs_bins_by_their_size() -> None:
    confidence = np.array([0.05] * 90 + [0.95] * 10)
    right = np.zeros(100, bool)
    assert expected_calibration_error(confidence, right) == pytest.approx(0.9 * 0.05 + 0.1 * 0.95)


def test_calibration_error_takes_any_shape_and_the_ends_of_the_range() -> None:
    confidence = np.array([[0.0, 1.0], [1.0, 0.0]])
    assert expected_calibration_error(confidence, confidence > 0.5) == pytest.approx(0)
