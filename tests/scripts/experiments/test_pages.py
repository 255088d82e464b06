"""Pages of results: rendered from their JSON, and never at odds with it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts.experiments.pages import compare, render, rows_of, table, write_section
from scripts.results import RESULTS

PAGES = [
    file for file in sorted(RESULTS.glob("*.json")) if "figures" in json.loads(file.read_text())
]
FUZZ = {
    "clients": 2,
    "seconds": 9.0,
    "uploads": 100,
    "shaped_percent": 0.2,
    "answers": {"200": 40, "400": 60},
    "broken": 0,
    "latency_ms": {"p50": 1.0, "p99": 2.0, "max": 3.0},
    "max_memory_mb": 500.0,
    "max_memory_wanted_mb": 600.0,
    "exit_status": 0,
    "failed": [],
}


@pytest.mark.parametrize("file", PAGES, ids=lambda file: file.stem)
def test_a_page_shows_the_figures_beside_it(file: Path) -> None:
    document = json.loads(file.read_text())
    assert document["command"].startswith("python -m scripts ")
    page = file.with_suffix(".md").read_text()
    assert page == render(file.stem, document), "run python -m scripts pages"


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


def test_rows_are_named_by_their_keys() -> None:
    figures = {"cars": {"red_ones": {"all": {"n": 1}}, "others": {"odd_ones": {"n": 2}}}}
    assert list(rows_of(figures, "cars.*")) == [
        {"group": "red ones", "name": "all", "slug": "all", "n": 1},
        {"group": "others", "name": "odd ones", "slug": "odd-ones", "n": 2},
    ]


def test_a_measurement_replaces_its_own_section_alone(tmp_path: Path) -> None:
    for failed in ([], ["memory reached 700 MB"]):
        write_section(tmp_path, "fuzz", "python -m scripts fuzz", {**FUZZ, "failed": failed})
    document = json.loads((tmp_path / "reliability.json").read_text())
    assert set(document) == {"command", "revision", "machine", "figures"}
    assert set(document["figures"]) == {"fuzz"}
    page = (tmp_path / "reliability.md").read_text()
    assert page.count("## Fuzzed uploads") == 1
    assert "40 x 200, 60 x 400" in page
    assert page.endswith("**Failed**: memory reached 700 MB.\n")
