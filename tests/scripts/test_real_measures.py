"""The measures of the real experiment, on answers that are known."""

from __future__ import annotations

import numpy as np
import pytest

from app.vision.geometry import Box
from scripts.experiments.real_detection_scores import average_precision, figures, matches
from scripts.experiments.real_vtest import Marks, compare

PEOPLE = np.array([[0.0, 0.0, 10.0, 30.0], [50.0, 0.0, 10.0, 30.0]])


def test_finding_everybody_first_is_perfect_precision() -> None:
    found = [(np.vstack([PEOPLE, [[100.0, 0.0, 10.0, 30.0]]]), np.array([0.9, 0.8, 0.1]))]
    assert average_precision(matches(found, [PEOPLE]), 2) == pytest.approx(1.0)
    measured = figures(found, [PEOPLE])
    assert measured["recall"] == measured["precision"] == 1.0


def test_a_second_box_on_one_person_is_false() -> None:
    found = [(PEOPLE[[0, 0]], np.array([0.9, 0.8]))]
    assert matches(found, [PEOPLE])[:, 1].tolist() == [1.0, 0.0]
    assert average_precision(matches(found, [PEOPLE]), 2) == pytest.approx(0.5)


def test_ignored_people_count_neither_way() -> None:
    marks = Marks(0, [Box(0, 0, 10, 30)], [Box(50, 0, 10, 30)])
    boxes = [Box(0, 1, 10, 30), Box(50, 1, 10, 30), Box(90, 0, 10, 30)]
    assert compare(boxes, marks) == (1, 1)
    assert compare([], marks) == (0, 0)
