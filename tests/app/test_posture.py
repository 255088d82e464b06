"""A person's posture, as the hypotheses vote."""

from __future__ import annotations

import pytest

from app.posture import vote_posture


def test_confidence_decides_rather_than_numbers() -> None:
    voted = vote_posture(["standing", "walking", "walking"], [0.9, 0.3, 0.3])
    assert voted.label == "standing"
    assert voted.probability == pytest.approx(0.6)


def test_confidences_of_one_posture_add_up() -> None:
    voted = vote_posture(["standing", "lying", "lying"], [0.5, 0.4, 0.3])
    assert voted.label == "lying"
    assert voted.probability == pytest.approx(0.7 / 1.2)


def test_of_equals_the_best_hypothesis_decides() -> None:
    assert vote_posture(["sitting", "kneeling"], [0.4, 0.4]).label == "sitting"


def test_hypotheses_without_confidence_know_nothing() -> None:
    voted = vote_posture(["sitting", "kneeling"], [0.0, 0.0])
    assert (voted.label, voted.probability) == ("sitting", 0.5)
