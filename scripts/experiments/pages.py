"""Pages of results: each is rendered from its JSON and a template, so that both say the same.

    python -m scripts pages     render all pages again, after a change of a template

A page ``docs/results/NAME.md`` lies beside ``NAME.json``, which holds command, revision, machine
and figures. Its template ``templates/NAME.md`` is a format string over the figures:

- ``{upright.right_1:.1f}`` is the figure ``right_1`` of ``upright``;
- a line ``@actions | {name} | {right_1:.1f} |`` is repeated for each of the figures of ``actions``,
  with a dash for a missing one; ``@street.*`` goes two levels deep, and ``{group}`` is the outer
  name;
- ``{parts.x}`` is the text that :data:`PARTS` makes of the figures.
"""

from __future__ import annotations

import argparse
import json
import shlex
import string
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from index.posture import LOW, POSTURES
from scripts.results import RESULTS, machine, revision

TEMPLATES = Path(__file__).with_name("templates")
RELIABILITY = ("cameras", "overload", "fuzz", "soak", "clients")
"""Measurements of a running server: each is a section of one page, and is repeated by itself."""

NAMES = {
    "both_networks_and_hog": "both networks and HOG",
    "movenet_alone": "MoveNet alone",
    "low": f"low: {', '.join(LOW)}",
    "paper": "paper's descriptor",
    "paper_nearest": "paper's descriptor",
    "paper_modes": "paper's, our matching",
    "ours_nearest": "ours, nearest",
    "ours_modes": "ours",
    "descriptor_alone": "the descriptor alone",
    "network_order": "the network: order",
    "network_order_and_weights": "the network: order, weights of candidates",
    "network_order_weights_and_fit": "the network: order, weights, fit",
    "network_alone": "the network alone, no search",
    "ours_in_order": "ours, frames in order",
    "mask": "`/pose` with a mask",
    "photograph": "`/pose`, people searched for",
}
"""Names of figures that are not their keys with spaces."""

Figures = Mapping[str, Any]


def write(out: Path, page: str, command: str, figures: Figures) -> None:
    """Write the JSON of a page, and the page with its plots."""
    _write_document(out, page, {**_origin(command), "figures": figures})


def report(page: str, arguments: Sequence[str] | None, figures: Figures, *, keep: bool) -> None:
    """Print the page of a command of its name; keep it in ``docs/results`` if asked to."""
    given = sys.argv[1:] if arguments is None else arguments
    command = shlex.join(["python", "-m", "scripts", page, *given])
    print(render(page, {**_origin(command), "figures": figures}))
    if keep:
        write(RESULTS, page, command, figures)


def write_section(out: Path, section: str, command: str, figures: Figures) -> None:
    """Replace a section of the page of reliability."""
    file = out / "reliability.json"
    known = json.loads(file.read_text())["figures"] if file.exists() else {}
    origin = _origin(command)
    sections = {**known, section: {**origin, **figures}}
    _write_document(out, "reliability", {**origin, "figures": sections})


def main(arguments: Sequence[str] | None = None) -> None:
    """Render pages again; plots stay as the measurement drew them."""
    parser = argparse.ArgumentParser(description="Render the pages of results from their JSON.")
    parser.add_argument("--out", type=Path, default=RESULTS)
    out = parser.parse_args(arguments).out
    for file in sorted(out.glob("*.json")):
        document = json.loads(file.read_text())
        if "figures" in document:
            file.with_suffix(".md").write_text(render(file.stem, document))
            print(file.with_suffix(".md"))


def _origin(command: str) -> dict[str, str]:
    return {"command": command, "revision": revision(), "machine": machine()}


def _write_document(out: Path, page: str, document: Figures) -> None:
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(document, indent=1)
    (out / f"{page}.json").write_text(text + "\n")
    document = json.loads(text)
    (out / f"{page}.md").write_text(render(page, document))
    for name, plot in PLOTS.get(page, {}).items():
        plot(document["figures"], out / name)


def render(page: str, document: Figures) -> str:
    """Return a page in Markdown."""
    if page != "reliability":
        return _fill(page, document, document["figures"])
    sections = document["figures"]
    rendered = [render_section(name, sections[name]) for name in RELIABILITY if name in sections]
    return "# Reliability\n\n" + "\n".join(rendered)


def render_section(section: str, figures: Figures) -> str:
    """Return a section of the page of reliability, with its verdict."""
    failed = figures["failed"]
    verdict = f"**Failed**: {'; '.join(failed)}." if failed else "Passed."
    return f"{_fill(section, figures, figures)}\n{verdict}\n"


def _fill(template: str, origin: Figures, figures: Figures) -> str:
    """Fill a template; a KeyError where it asks for a figure that is not there."""
    values = {
        **figures,
        "provenance": f"`{origin['command']}`, revision {origin['revision']}, {origin['machine']}.",
        "parts": {name: make(figures) for name, make in PARTS.get(template, {}).items()},
    }
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
            found = found[part]
        return found, name


class _Row(_Text):
    """The same, with a dash for a figure that is missing or None."""

    def get_field(self, name: str, arguments: Any, values: Any) -> tuple[Any, str]:
        """Return a figure, or None."""
        try:
            return super().get_field(name, arguments, values)
        except KeyError:
            return None, name

    def format_field(self, value: Any, form: str) -> str:
        """Return a cell."""
        return "-" if value is None else str(super().format_field(value, form))


_TEXT, _ROW = _Text(), _Row()


def rows_of(figures: Figures, path: str) -> Iterator[dict[str, Any]]:
    """Yield the figures of a path with ``name``, ``group`` and, with hyphens, ``slug`` of each."""
    groups: list[tuple[str, Any]] = [("", figures)]
    for part in path.split("."):
        if part == "*":
            groups = [(named(key), value) for _, found in groups for key, value in found.items()]
        else:
            groups = [(group, found[part]) for group, found in groups]
    for group, found in groups:
        items = found.items() if isinstance(found, dict) else (("", one) for one in found)
        for key, one in items:
            yield {"group": group, "name": named(key), "slug": key.replace("_", "-"), **one}


def named(key: str) -> str:
    """Return a key as it is printed."""
    return NAMES.get(key, key.replace("_", " "))


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; a ValueError if a row is not as long as the header."""
    lines = [_line(header), _line(["---"] * len(header))]
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"expected {len(header)} cells, got {len(row)}: {', '.join(row)}")
        lines.append(_line(row))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def confusion_table(names: Sequence[str], counts: Sequence[Sequence[int]]) -> str:
    """Return a table of counts: truth in rows, answers in columns; empty rows are left out."""
    rows = [
        [name, *(str(count or "") for count in row)]
        for name, row in zip(names, counts, strict=True)
        if any(row)
    ]
    return table(["", *names], rows)


def confusion_tables(names: Sequence[str], figures: Figures) -> str:
    """Return a table of counts under a heading for each of some figures."""
    return "\n\n".join(
        f"### Confusions, {named(key)}\n\n{confusion_table(names, one['confusion'])}"
        for key, one in figures.items()
    )


def counts_table(counts: Mapping[str, Mapping[str, int]]) -> str:
    """Return a table of counts by two names."""
    columns = sorted({label for row in counts.values() for label in row})
    return table(
        ["", *columns],
        [[name, *(str(row.get(label) or "") for label in columns)] for name, row in counts.items()],
    )


def counts(figures: Mapping[str, int]) -> str:
    """Return counts of statuses in a line."""
    return ", ".join(f"{number} x {status}" for status, number in figures.items())


def compare(pairs: Sequence[tuple[float, float]]) -> str:
    """Count how often the first of a pair is above the second, as printed."""
    printed = [(round(ours, 2), round(other, 2)) for ours, other in pairs]
    above = sum(ours > other for ours, other in printed)
    equal = sum(ours == other for ours, other in printed)
    words = [f"above in {above} of {len(pairs)} cells"]
    if equal:
        words.append(f"equal in {equal}")
    if above + equal < len(pairs):
        words.append(f"below in {len(pairs) - above - equal}")
    return ", ".join(words)


def compare_ours(figures: Figures, other: str) -> str:
    """Compare our recognition rates with those of another column, where it has any."""
    rows = figures["noise"].values()
    return compare([(row["ours_modes"], row[other]) for row in rows if row[other] is not None])


PARTS: dict[str, dict[str, Callable[[Any], str]]] = {
    "paper-noise": {
        "against_published": lambda figures: compare_ours(figures, "published"),
        "against_paper": lambda figures: compare_ours(figures, "paper_nearest"),
    },
    "simulation": {
        "confusion": lambda figures: confusion_table(POSTURES, figures["posture_confusion"]),
        "held_out": lambda figures: ", ".join(figures["held_out_clips"]),
    },
    "actions": {
        "recognised": lambda figures: ", ".join(figures["actions"]),
        "left_out": lambda figures: ", ".join(figures["left_out_clips"]),
        "acrobatics": lambda figures: ", ".join(figures["acrobatics"]),
        "confusions": lambda figures: confusion_tables(figures["actions"], figures["sequences"]),
    },
    "weizmann": {
        "confusions": lambda figures: confusion_tables(figures["actions"], figures["votes"]),
        "counts": lambda figures: counts_table(figures["session_counts"]),
    },
    "bench": {
        "left_out": lambda figures: "\n".join(map("Left out: {}.".format, figures["left_out"]))
    },
    "fuzz": {"answers": lambda figures: counts(figures["answers"])},
    "soak": {
        "answers": lambda figures: table(
            ["request", "answers"],
            [[named(kind), counts(one) or "-"] for kind, one in figures["answers"].items()],
        ),
        "memory": lambda figures: ", ".join(f"{mb:.0f}" for mb in figures["memory_mb_by_tenth"]),
    },
}
"""Parts of pages that are more than a line for each figure."""


def plot_noise(figures: Figures, file: Path) -> None:
    """Draw recognition over noise, N = 1 and N = 7 side by side."""
    plt = _pyplot()
    canvas, panels = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axes, n in zip(panels, (1, 7), strict=True):
        rows = [row for row in figures["noise"].values() if row["n"] == n]
        noise = [row["std_px"] for row in rows]
        for column, colour in NOISE_COLOURS.items():
            line = "--" if column == "published" else "-"
            values = [row[column] for row in rows]
            axes.plot(noise, values, line, marker="o", color=colour, label=named(column))
        axes.set(title=f"N = {n}", xlabel="noise on the contour (px)", xticks=noise)
        axes.grid(alpha=0.3)
    panels[0].set(ylabel="recognised (%)", ylim=(40, 101))
    panels[0].legend(loc="lower left")
    canvas.savefig(file, dpi=120)
    plt.close(canvas)


def plot_reliability(curves: Mapping[str, Sequence[Figures]], file: Path) -> None:
    """Draw the share of right hypotheses over the confidence stated, a line for each name."""
    plt = _pyplot()
    canvas, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for name, bins in curves.items():
        stated, right = ([one[key] for one in bins] for key in ("stated", "right"))
        axes.plot(stated, right, marker="o", label=named(name))
    limits = (0, 1)
    axes.set(xlabel="confidence", ylabel="share that is right", xlim=limits, ylim=limits)
    axes.set_aspect("equal")
    axes.legend()
    canvas.savefig(file, dpi=120)
    plt.close(canvas)


def _pyplot() -> Any:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt


NOISE_COLOURS = {
    "published": "0.45",
    "paper_nearest": "C1",
    "paper_modes": "C5",
    "ours_nearest": "C2",
    "ours_modes": "C0",
}
PLOTS: dict[str, dict[str, Callable[[Any, Path], None]]] = {
    "paper-noise": {"paper-noise.png": plot_noise},
    "simulation": {
        "simulation-reliability.png": lambda figures, file: plot_reliability(
            figures["reliability"], file
        )
    },
    "real": {
        "real-reliability.png": lambda figures, file: plot_reliability(
            {name: one["bins"] for name, one in figures["confidence"].items()}, file
        )
    },
}
