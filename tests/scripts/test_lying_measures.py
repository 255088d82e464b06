"""The measures of people who lie, on made-up trials."""

from __future__ import annotations

import numpy as np
import pytest

from scripts.experiments.real_lying import RARITY, Part, Trial, fitted_lying, lying_figures


def trials(spread: float) -> list[Trial]:
    """Forty photographs of two people each, one of whom is wide; joints show in people."""
    rng = np.random.default_rng(0)

    def part(clarity: float, right: bool) -> Part:
        return Part(clarity + rng.normal(0, spread), right, right)

    return [
        Trial([part(-3.0, False)], [part(-0.5, True), part(-3.0, False)], people=2)
        for _ in range(40)
    ]


def test_who_shows_clearly_is_found_and_nobody_else() -> None:
    figures = lying_figures(trials(spread=0.01))
    assert figures["people"] == 80
    assert figures["reachable"] == figures["found"] == 0.5
    assert figures["wrong_way"] == figures["false_turned"] == figures["false_upright"] == 0


def test_where_joints_tell_nothing_nobody_is_found() -> None:
    same = [
        Trial([Part(-1.0, False, False)], [Part(-1.0, True, True)], people=1) for _ in range(40)
    ]
    assert lying_figures(same)["found"] == 0


def test_people_who_lie_count_as_rare() -> None:
    same = [
        Trial([Part(-1.0, False, False)], [Part(-1.0, True, True)], people=1) for _ in range(40)
    ]
    weight, offset = fitted_lying(same)
    odds = np.exp(weight * -1.0 + offset)
    assert odds == pytest.approx(RARITY, rel=0.05)
