"""What every experiment leaves behind: a Markdown page, its figures as JSON, its command."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


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


def confusion(names: Sequence[str], truth: NDArray[np.integer], told: NDArray[np.integer]) -> str:
    """A table of counts: truth in rows, answers in columns, both positions in ``names``."""
    counts = np.zeros((len(names), len(names)), int)
    np.add.at(counts, (truth, told), 1)
    return table(
        ["", *names],
        (
            [name, *(str(count) if count else "" for count in row)]
            for name, row in zip(names, counts.tolist(), strict=True)
            if any(row)
        ),
    )


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


def reliability(
    confidence: NDArray[np.floating], right: NDArray[np.bool_], bins: int
) -> list[dict[str, float]]:
    """Confidences stated and met in bins of equal width; those that hold none are left out."""
    bin_of = np.minimum((confidence * bins).astype(int), bins - 1)
    return [
        {
            "from": b / bins,
            "to": (b + 1) / bins,
            "hypotheses": int((bin_of == b).sum()),
            "stated": float(confidence[bin_of == b].mean()),
            "right": float(right[bin_of == b].mean()),
        }
        for b in np.unique(bin_of).tolist()
    ]


def plot_reliability(curves: Mapping[str, Sequence[Mapping[str, float]]], file: Path) -> None:
    """Draw the share of right hypotheses over the confidence stated, a line for each name."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for name, bins in curves.items():
        stated, right = ([one[key] for one in bins] for key in ("stated", "right"))
        axes.plot(stated, right, marker="o", label=name)
    axes.set(
        xlabel="confidence", ylabel="share that is right", xlim=(0, 1), ylim=(0, 1), aspect="equal"
    )
    axes.legend()
    figure.savefig(file, dpi=120)
    plt.close(figure)


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
