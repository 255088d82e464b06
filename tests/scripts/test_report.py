"""Pages of results: tables that hold together, figures beside them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts.experiments.report import compare, table, write


def test_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected 2 cells, got 1: only"):
        table(["a", "b"], [["only"]])


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ([(2.0, 1.0), (3.0, 1.0)], "above in 2 of 2 cells"),
        ([(2.0, 1.0), (100.0, 100.0)], "above in 1 of 2 cells, equal in 1"),
        ([(1.0, 2.0), (5.0, 4.0)], "above in 1 of 2 cells, below in 1"),
        # What is printed is compared: 98.811 and 98.81 read alike.
        ([(98.811, 98.81)], "above in 0 of 1 cells, equal in 1"),
    ],
)
def test_compare_counts_what_is_printed(pairs: list[tuple[float, float]], words: str) -> None:
    assert compare(pairs) == words


def test_page_and_figures_name_their_command(tmp_path: Path) -> None:
    out = tmp_path / "new" / "results"
    write(out, "noise", "python -m x", ["Noise", "One.\n", "Two."], {"rates": {1: (0.5, 1.0)}})
    assert (out / "noise.md").read_text() == "# Noise\n\n`python -m x`\n\nOne.\n\nTwo.\n"
    figures = json.loads((out / "noise.json").read_text())
    assert figures == {"command": "python -m x", "rates": {"1": [0.5, 1.0]}}
