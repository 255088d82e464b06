"""Keep the figures that documents quote equal to the results that measured them.

    python -m scripts figures [--check]

A quoted number is followed by a comment with its key: ``377<!-- bench.memory_mb -->`` is
``figures.memory_mb`` of ``docs/results/bench.json``. The command rewrites such
numbers with as many decimals as stand in the text; ``--check`` changes nothing and exits with 1
where one differs.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from scripts.results import RESULTS, ROOT

_QUOTED = re.compile(r"(?P<number>-?\d[\d,]*(?:\.\d+)?)<!-- (?P<key>[^\s>]+) -->")
_COMMENT = re.compile(r"<!--\s*[\w-]+(?:\.[\w-]+)+\s*-->")


def documents() -> list[Path]:
    """The files whose figures are kept up to date."""
    pages = [*(ROOT / "docs").glob("*.md"), RESULTS / "README.md"]
    return [ROOT / "README.md", *sorted(page for page in pages if page.exists())]


def measured(key: str, results: Path = RESULTS) -> float:
    """Look up a figure by ``page.path.to.figure``.

    Raises
    ------
    KeyError
        If no result has such a figure.
    """
    page, *path = key.split(".")
    node = _figures(results / f"{page}.json")
    for name in path:
        node = node.get(name) if isinstance(node, dict) else None
    if isinstance(node, bool) or not isinstance(node, int | float):
        raise KeyError(f"expected a number at {key} in {results}, there is none")
    return node


def updated(text: str, results: Path = RESULTS) -> str:
    """The text with each quoted number as it was measured; its decimals stay as many.

    Raises
    ------
    KeyError
        If no result has a figure that is quoted.
    ValueError
        If a comment with a key does not follow a number.
    """
    quoted = {match.end() for match in _QUOTED.finditer(text)}
    for comment in _COMMENT.finditer(text):
        if comment.end() not in quoted:
            raise ValueError(f"expected a number right before {comment.group()}")

    def as_measured(match: re.Match[str]) -> str:
        decimals = len(match["number"].partition(".")[2])
        return f"{measured(match['key'], results):,.{decimals}f}<!-- {match['key']} -->"

    return _QUOTED.sub(as_measured, text)


def differences(before: str, after: str) -> Iterator[str]:
    """Describe each number that has changed."""
    for old, new in zip(_QUOTED.finditer(before), _QUOTED.finditer(after), strict=True):
        if old["number"] != new["number"]:
            yield f"{old['key']} is {new['number']}, the text says {old['number']}"


@cache
def _figures(file: Path) -> object:
    if not file.is_file():
        raise KeyError(f"expected results in {file}, there are none")
    return json.loads(file.read_text())["figures"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; 1 where ``--check`` finds a figure that differs."""
    parser = argparse.ArgumentParser(description="Write measured figures into the documents.")
    parser.add_argument("--check", action="store_true", help="only say what would change")
    check = parser.parse_args(arguments).check
    changed = False
    for document in documents():
        before = document.read_text()
        after = updated(before)
        for difference in differences(before, after):
            changed = True
            print(f"{document.relative_to(ROOT)}: {difference}")
        if not check and after != before:
            document.write_text(after)
    return 1 if check and changed else 0
