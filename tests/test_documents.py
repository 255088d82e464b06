"""Links between the documents lead somewhere."""

import json
import re
from pathlib import Path

import pytest

from index import DEFAULT_PATH
from tests.conftest import ROOT

DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "docs/notes/*.md", "docs/results/*.md", "deploy/*.md")
    for path in ROOT.glob(pattern)
)

_LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")
_CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", _CODE.sub("", page.read_text()), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings
    }


@pytest.mark.parametrize("page", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for name, anchor in _LINK.findall(_CODE.sub("", page.read_text())):
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), name
        if anchor:
            assert anchor in anchors(target), f"{name}#{anchor}"


def test_every_page_of_results_is_in_the_index() -> None:
    results = ROOT / "docs" / "results"
    index = (results / "README.md").read_text()
    for page in results.glob("*.md"):
        assert page.name == "README.md" or f"]({page.name})" in index, page.name


def test_the_readme_counts_the_entries_that_ship() -> None:
    manifest = json.loads((DEFAULT_PATH / "manifest.json").read_text())
    poses, views = (manifest["parameters"][name] for name in ("poses", "views_per_body"))
    counted = f"{manifest['entries']:,} of them: {poses:,} poses, each seen from {views} views"
    assert counted in " ".join((ROOT / "README.md").read_text().split())


def test_the_readme_is_read_within_minutes() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    assert len(text.split()) <= 1300
