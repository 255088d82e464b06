"""The comparison with MediaPipe: its film, its ratios, and what it says where it cannot run."""

import sys
from pathlib import Path

import numpy as np
import pytest

from scripts.load.peer import PEOPLE, film, ratios, why_not


def test_a_film_shows_so_many_people_side_by_side() -> None:
    frame = np.zeros((1920, 1080, 3), np.uint8)
    frame[200:1280, 200:680] = 255
    for people in PEOPLE:
        (made,) = film([frame], people)
        assert made.shape == (1080, 1920, 3)
        assert made.mean() == pytest.approx(255 * people / 4)


def test_a_further_person_costs_what_they_add() -> None:
    assert ratios({1: 30.0, 2: 50.0, 4: 60.0}, 20.0) == {
        1: {"ratio": 1.5},
        2: {"ratio": 2.5, "further_ratio": 1.0},
        4: {"ratio": 3.0, "further_ratio": 0.5},
    }


def test_it_says_why_mediapipe_cannot_be_measured(tmp_path: Path) -> None:
    assert "No such file" in str(why_not(tmp_path / "python"))
    assert why_not(Path(sys.executable)) in (
        None,
        "ModuleNotFoundError: No module named 'mediapipe'",
    )
