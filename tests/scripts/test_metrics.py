"""Metrics, on answers that are known."""

import numpy as np
import pytest

from scripts.metrics import average_precision, detection_figures, matches

PEOPLE = np.array([[0.0, 0.0, 10.0, 30.0], [50.0, 0.0, 10.0, 30.0]])


def test_finding_everybody_first_is_perfect_precision() -> None:
    found = [(np.vstack([PEOPLE, [[100.0, 0.0, 10.0, 30.0]]]), np.array([0.9, 0.8, 0.1]))]
    assert average_precision(matches(found, [PEOPLE]), 2) == pytest.approx(1.0)
    measured = detection_figures(found, [PEOPLE])
    assert measured["recall"] == measured["precision"] == 1.0


def test_a_second_box_on_one_person_is_false() -> None:
    found = [(PEOPLE[[0, 0]], np.array([0.9, 0.8]))]
    assert matches(found, [PEOPLE])[:, 1].tolist() == [1.0, 0.0]
    assert average_precision(matches(found, [PEOPLE]), 2) == pytest.approx(0.5)
