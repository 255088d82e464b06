"""The street video: what counts as found, and as false."""

from __future__ import annotations

import pytest

pytest.importorskip("sklearn", reason="needs the test extra: scikit-learn")

from app.vision.geometry import Box
from scripts.datasets import Marks
from scripts.experiments.real import compare


def test_ignored_people_count_neither_way() -> None:
    marks = Marks(0, [Box(0, 0, 10, 30)], [Box(50, 0, 10, 30)])
    boxes = [Box(0, 1, 10, 30), Box(50, 1, 10, 30), Box(90, 0, 10, 30)]
    assert compare(boxes, marks) == (1, 1)
    assert compare([], marks) == (0, 0)
