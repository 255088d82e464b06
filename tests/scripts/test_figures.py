"""Figures that documents quote are those that were measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts.figures import RESULTS, differences, documents, updated
from tests.conftest import ROOT


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Results of one page."""
    figures = {"street": {"right": 96.66, "people": 1050}}
    (tmp_path / "real.json").write_text(json.dumps({"figures": figures}))
    return tmp_path


@pytest.mark.parametrize("document", documents(), ids=lambda path: str(path.relative_to(ROOT)))
def test_quoted_figures_are_those_measured(document: Path) -> None:
    text = document.read_text()
    assert list(differences(text, updated(text))) == [], "run python -m scripts figures"


@pytest.mark.parametrize("file", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_results_say_what_made_them(file: Path) -> None:
    assert {"command", "revision", "machine", "figures"} <= set(json.loads(file.read_text()))
    assert file.with_suffix(".md").exists()


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("1<!-- real.street.right -->", "97<!-- real.street.right -->"),
        ("| 1.0<!-- real.street.right --> % |", "| 96.7<!-- real.street.right --> % |"),
        ("of 7<!-- real.street.people -->,", "of 1,050<!-- real.street.people -->,"),
        ("12 <!-- a remark --> 13", "12 <!-- a remark --> 13"),
    ],
)
def test_decimals_of_the_text_are_kept(before: str, after: str, results: Path) -> None:
    assert updated(before, results) == after
    assert updated(after, results) == after


@pytest.mark.parametrize("key", ["real.street", "real.street.left", "other.street", "real"])
def test_a_key_without_a_figure_is_refused(key: str, results: Path) -> None:
    with pytest.raises(KeyError, match="expected"):
        updated(f"1<!-- {key} -->", results)


def test_a_key_without_a_number_is_refused(results: Path) -> None:
    with pytest.raises(ValueError, match="right before"):
        updated("most <!-- real.street.right -->", results)


def test_what_differs_is_named() -> None:
    (said,) = differences("2<!-- a.b --> 3<!-- a.c -->", "2<!-- a.b --> 4<!-- a.c -->")
    assert said == "a.c is 4, the text says 3"
