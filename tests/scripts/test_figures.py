"""Pages and documents say what was measured; templates are filled, and what they lack is named."""

import json
from pathlib import Path

import pytest

from scripts import figures
from scripts.figures import RESULTS, rendered, report_section, updated


def test_every_page_and_document_says_what_was_measured() -> None:
    different = [page for page, text in rendered() if page.read_text() != text]
    assert different == [], "run python -m scripts figures"


@pytest.mark.parametrize("file", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_results_say_what_made_them(file: Path) -> None:
    document = json.loads(file.read_text())
    assert set(document) == {"command", "revision", "date", "machine", "figures"}
    assert document["command"].startswith("python -m scripts ")


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Results of one page, and a template of a document that quotes them."""
    measured = {
        "right": 96.66,
        "people": 1050,
        "walks": {"a": {"n": 1}, "b": {}},
        "clips": ["x", "y"],
    }
    document = {"command": "c", "revision": "r1", "machine": "m", "figures": measured}
    (tmp_path / "real.json").write_text(json.dumps(document))
    (tmp_path / "documents").mkdir()
    monkeypatch.setattr(figures, "TEMPLATES", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{real.right:.0f} % of {real.people:,}", "97 % of 1,050"),
        ("at {real.revision}, {{braces}}", "at r1, {braces}"),
        ("{real.clips}", "x, y"),
        ("@real.walks {name}: {n}", "a: 1\nb: -"),
    ],
)
def test_a_document_is_filled_between_its_marks(template: str, text: str, results: Path) -> None:
    (results / "documents" / "one.md").write_text(template + "\n")
    before = "Before.\n<!-- figures: one -->\nold\n<!-- end of figures -->\nAfter.\n"
    after = updated(before, results)
    assert after == before.replace("old", text)
    assert updated(after, results) == after


def test_a_figure_that_is_missing_is_named(results: Path) -> None:
    (results / "documents" / "one.md").write_text("{real.left}\n")
    with pytest.raises(KeyError, match=r"expected a figure real\.left"):
        updated("<!-- figures: one -->\n<!-- end of figures -->\n", results)


def test_a_measurement_replaces_its_own_section_alone(tmp_path: Path) -> None:
    soak = figures.measured("reliability")["soak"]
    for failed in ([], ["memory grew"]):
        report_section("soak", "python -m scripts soak", {**soak, "failed": failed}, tmp_path)
    document = json.loads((tmp_path / "reliability.json").read_text())
    assert set(document["figures"]) == {"soak"}
    page = (tmp_path / "reliability.md").read_text()
    assert page.count("## Soak") == 1
    assert f"{soak['requests']} requests" in page
    assert page.endswith("**Failed**: memory grew.\n")
