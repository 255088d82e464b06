"""Write measured figures into pages and documents, so that all say what the JSON says.

    python -m scripts figures [--check]

A measurement writes ``docs/results/NAME.json``: command, revision and its date, machine, figures.
This command renders ``NAME.md`` beside it from ``templates/NAME.md``, and in other documents what
stands between ``<!-- figures: NAME -->`` and ``<!-- end of figures -->`` from
``templates/documents/NAME.md``.
With ``--check`` it changes nothing, and exits with 1 if a document differs.

A template is text with format strings:

- ``{upright.right_1:.1f}`` is the figure ``right_1`` of ``upright``; in documents, the first name
  is that of a page, as in ``{simulation.summary.upright.right_1:.1f}``, ``{simulation.revision}``;
- a line ``@actions | {name} | {right_1:.1f} |`` is repeated for each of the figures of ``actions``,
  with a dash for a missing one; ``@street.*`` goes two levels deep, and ``{group}`` is the outer
  name;
- a list is written with commas, counts by name as ``40 x 200, 60 x 400``;
- ``{confusion}`` is a table of the postures that were taken for others.
"""

import argparse
import json
import re
import shlex
import string
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from index.posture import LOW, SILHOUETTE_GROUPS
from scripts.results import RESULTS, ROOT, date, machine, revision

TEMPLATES = Path(__file__).with_name("templates")
RELIABILITY = ("cameras", "soak")
"""Measurements of a running server: each is a section of one page, and is repeated by itself."""

NAMES = {
    "both_networks_and_hog": "both networks and HOG",
    "movenet_alone": "MoveNet alone",
    "hog": "HOG alone, over many scales (`method=paper`)",
    "paper_method": "the paper's method",
    "paper_method_network_silhouettes": "the paper's method, silhouettes by the network",
    "low": f"low: {', '.join(LOW)}",
    "paper": "paper's descriptor",
    "ours_nearest": "ours, nearest",
    "silhouette_not_reranked": "silhouette, without re-ranking",
    "silhouette_permuted": "silhouette, index permuted",
    "silhouette_and_landmarks": "silhouette and landmarks (default)",
    "silhouette_and_landmarks_permuted": "silhouette and landmarks, index permuted",
    "hu": "Hu",
    "zernike": "Zernike",
    "hahn": "Hahn",
    "hog_of_silhouette": "HOG of the silhouette",
    "pixels": "raw pixels",
    "krawtchouk_paper": "Krawtchouk, paper",
    "krawtchouk_ours": "Krawtchouk, ours",
    "descriptor_alone": "the descriptor alone",
    "network_order": "the network: order",
    "network_order_and_weights": "the network: order, weights of candidates",
    "network_order_weights_and_fit": "the network: order, weights, fit",
    "network_alone": "the network alone, no search",
    "mask": "`/pose` with a mask",
    "photograph": "`/pose`, people searched for",
}
"""Names of figures that are not their keys with spaces."""

Figures = Mapping[str, Any]
_PART = re.compile(r"(<!-- figures: ([\w-]+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)


def write(out: Path, page: str, command: str, figures: Figures) -> None:
    """Write the JSON of a page, and the page."""
    out.mkdir(parents=True, exist_ok=True)
    document = {**_origin(command), "figures": figures}
    (out / f"{page}.json").write_text(json.dumps(document, indent=1) + "\n")
    (out / f"{page}.md").write_text(render(out / f"{page}.json"))


def report(page: str, arguments: Sequence[str] | None, figures: Figures, *, keep: bool) -> None:
    """Print the page of a command of its name; keep it in ``docs/results`` if asked to."""
    given = sys.argv[1:] if arguments is None else arguments
    command = shlex.join(["python", "-m", "scripts", page, *given])
    print(_fill(page, figures, _origin(command)))
    if keep:
        write(RESULTS, page, command, figures)


def report_section(section: str, command: str, figures: Figures, out: Path | None) -> None:
    """Print a section of the page of reliability; replace it in a folder if there is one."""
    section_figures = {**_origin(command), **figures}
    print(_render_section(section, section_figures))
    if out is not None:
        file = out / "reliability.json"
        known = json.loads(file.read_text())["figures"] if file.exists() else {}
        write(out, "reliability", command, {**known, section: section_figures})


def _origin(command: str) -> dict[str, str]:
    return {"command": command, "revision": revision(), "date": date(), "machine": machine()}


def render(file: Path) -> str:
    """Return the page of a JSON of results, in Markdown."""
    document = json.loads(file.read_text())
    figures = document["figures"]
    if file.stem != "reliability":
        return _fill(file.stem, figures, document)
    sections = [_render_section(name, figures[name]) for name in RELIABILITY if name in figures]
    return "# Reliability\n\n" + "\n".join(sections)


def _render_section(section: str, figures: Figures) -> str:
    failed = figures["failed"]
    verdict = f"**Failed**: {'; '.join(failed)}." if failed else "Passed."
    return f"{_fill(section, figures, figures)}\n{verdict}\n"


def measured(page: str) -> Figures:
    """Return the figures of a page."""
    figures: Figures = json.loads((RESULTS / f"{page}.json").read_text())["figures"]
    return figures


def updated(text: str, results: Path = RESULTS) -> str:
    """Return a document whose parts with figures say what was measured.

    Raises
    ------
    KeyError
        If a template asks for a figure that is not there.
    """

    def part(match: re.Match[str]) -> str:
        pages = {}
        for file in results.glob("*.json"):
            document = json.loads(file.read_text())
            pages[file.stem] = {**document, **document["figures"]}
        return match[1] + _fill(f"documents/{match[2]}", pages) + match[3]

    return _PART.sub(part, text)


def _fill(template: str, figures: Figures, origin: Figures | None = None) -> str:
    values = dict(figures)
    if "posture_confusion" in figures:
        names = [*SILHOUETTE_GROUPS.names, "unclear"]
        values["confusion"] = _counts(names, figures["posture_confusion"])
    if origin is not None:
        values["provenance"] = (
            f"`{origin['command']}`, revision {origin['revision']} ({origin['date']}), "
            f"{origin['machine']}."
        )
    lines: list[str] = []
    for line in (TEMPLATES / f"{template}.md").read_text().splitlines():
        path, _, row = line.partition(" ")
        if path.startswith("@"):
            lines += [_ROW.vformat(row, (), one) for one in rows_of(figures, path[1:])]
        else:
            lines.append(_TEXT.vformat(line, (), values))
    return "\n".join(lines) + "\n"


class _Text(string.Formatter):
    """Format strings over nested figures: ``{a.b.c:.1f}``."""

    def get_field(self, name: str, _: Any, values: Any) -> tuple[Any, str]:
        """Return a figure."""
        found = values
        for part in name.split("."):
            if part not in found:
                raise KeyError(f"expected a figure {name}, there is none")
            found = found[part]
        return found, name

    def format_field(self, value: Any, form: str) -> str:
        """Return a figure as text."""
        if value is None or value in ([], {}):
            return "-"
        if isinstance(value, list):
            return ", ".join(self.format_field(one, form) for one in value)
        if isinstance(value, dict):
            return ", ".join(f"{number} x {name}" for name, number in value.items())
        return str(super().format_field(value, form))


class _Row(_Text):
    """The same, without a figure for one that is missing."""

    def get_field(self, name: str, arguments: Any, values: Any) -> tuple[Any, str]:
        """Return a figure, or None."""
        try:
            return super().get_field(name, arguments, values)
        except KeyError:
            return None, name


_TEXT, _ROW = _Text(), _Row()


def rows_of(figures: Figures, path: str) -> Iterator[dict[str, Any]]:
    """Yield the figures of a path: ``value``, what it holds, ``name``, ``group`` and ``slug``."""
    groups: list[tuple[str, Any]] = [("", figures)]
    for part in path.split("."):
        if part == "*":
            groups = [(named(key), value) for _, found in groups for key, value in found.items()]
        else:
            groups = [(group, found[part]) for group, found in groups]
    for group, found in groups:
        items = found.items() if isinstance(found, dict) else (("", one) for one in found)
        for key, one in items:
            names = {"group": group, "name": named(key), "slug": key.replace("_", "-")}
            yield {**names, "value": one, **one}


def named(key: str) -> str:
    """Return a key as it is printed."""
    return NAMES.get(key, key.replace("_", " "))


def _counts(names: Sequence[str], counts: Sequence[Sequence[int]]) -> str:
    """Return a table of counts: truth in rows, answers in columns; empty rows are left out."""
    rows = [["", *names], ["---"] * (len(names) + 1)]
    rows += [[name, *(str(n or "") for n in row)] for name, row in zip(names, counts, strict=True)
             if any(row)]  # fmt: skip
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def rendered() -> Iterator[tuple[Path, str]]:
    """Yield every page and document that holds figures, with the text that it should have."""
    for file in sorted(RESULTS.glob("*.json")):
        yield file.with_suffix(".md"), render(file)
    documents = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "notes").glob("*.md")]
    for document in (ROOT / "README.md", *sorted(documents), RESULTS / "README.md"):
        yield document, updated(document.read_text())


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; 1 if ``--check`` finds a document that differs."""
    parser = argparse.ArgumentParser(description="Write measured figures into pages and documents.")
    parser.add_argument("--check", action="store_true", help="only say what would change")
    check = parser.parse_args(arguments).check
    changed = [(page, text) for page, text in rendered() if page.read_text() != text]
    for page, text in changed:
        print(page.relative_to(ROOT))
        if not check:
            page.write_text(text)
    return 1 if check and changed else 0
