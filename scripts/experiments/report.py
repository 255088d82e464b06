"""What every experiment leaves behind: a Markdown page, its figures as JSON, its command."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table.

    Raises
    ------
    ValueError
        If a row is not as long as the header.
    """
    lines = [_line(header), _line(["---"] * len(header))]
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"expected {len(header)} cells, got {len(row)}: {', '.join(row)}")
        lines.append(_line(row))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def percent(value: float | None) -> str:
    """A share as the paper prints it, two digits after the point; a dash where it is unknown."""
    return "-" if value is None else f"{value:.2f}"


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


def write(
    out: Path, name: str, command: str, paragraphs: Sequence[str], figures: Mapping[str, object]
) -> None:
    """Write ``name.md`` and ``name.json``.

    Parameters
    ----------
    out : Path
        Folder of the results; made if it is missing.
    name : str
    command : str
        That makes these results; goes below the title and into the JSON.
    paragraphs : sequence of str
        The title first.
    figures : mapping
        Everything the page shows, as JSON values.
    """
    out.mkdir(parents=True, exist_ok=True)
    title, *rest = paragraphs
    text = "\n\n".join([f"# {title}", f"`{command}`", *(part.strip() for part in rest)])
    (out / f"{name}.md").write_text(text + "\n")
    (out / f"{name}.json").write_text(json.dumps({"command": command, **figures}, indent=1) + "\n")
