"""What is fitted or trained reads only data whose terms allow products."""

import ast
import re
from pathlib import Path

import pytest

from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "data.md").read_text()
FREE = {"Apache-2.0", "BSD-3-Clause", "MIT", "CC BY 4.0", "CC0"}
MODULES = [
    file
    for folder in ("scripts/training", "scripts/index")
    for file in sorted((ROOT / folder).rglob("*.py"))
]


def terms() -> dict[str, set[str]]:
    """The terms of every folder of ``real``."""
    rows = re.findall(r"^\| ((?:`real/\w+`(?:, )?)+) \|.*\| (.*) \|$", PAGE, re.MULTILINE)
    return {
        name: set(last.split("; "))
        for names, last in rows
        for name in re.findall(r"real/(\w+)", names)
    }


def folders_read(source: str) -> set[str]:
    """Folders of ``real`` that a module names, and those of the readers that it imports."""
    named = set(re.findall(r'\breal"? ?/ ?"?(\w+)', source))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module == "scripts.datasets":
            named |= {alias.name for alias in node.names if alias.name.startswith("read_")}
    return {name.removeprefix("read_") for name in named} - {"marks"}


def is_free(folder: str) -> bool:
    """Whether all terms of a folder allow products; not those of a folder that the page lacks."""
    return terms().get(folder, {"unknown"}) <= FREE


def test_the_page_says_the_terms_of_every_folder() -> None:
    assert terms()["vtest"] == {"Apache-2.0"} and not terms()["lsp"] & FREE


@pytest.mark.parametrize(
    "source",
    [
        'photographs = shared / "real" / "pennfudan"',
        'film = "real/urfd"',
        "from scripts.datasets import read_lsp",
        "from scripts.datasets import read_street_people",
    ],
)
def test_reading_data_is_noticed(source: str) -> None:
    (folder,) = folders_read(source)
    assert not is_free(folder)


@pytest.mark.parametrize("file", MODULES, ids=lambda file: str(file.relative_to(ROOT)))
def test_what_is_fitted_reads_free_data(file: Path) -> None:
    assert all(map(is_free, folders_read(file.read_text())))
