"""The page and the plot of the searches in the process of the service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from scripts.experiments.report import table, write
from scripts.results import machine

DEFAULTS = {"flat": {}, "ivf": {"nprobe": 64}, "hnsw": {"ef_search": 256}}
WITHIN_MS = 50.0
"""A share of a frame's time that a search may take."""

WORTH_MS = 10.0
"""Time that is worth an answer or two in a hundred."""

Figures = Mapping[str, Any]


def report(figures: Figures, sizes: Sequence[int], command: str, out: Path) -> None:
    """Write the page, the figures and the plot from the figures of all cases."""
    made, vectors = figures["vectors"], figures["answers"]["vectors_a_search"]
    text = [
        "Searches in the process of the service, by size",
        f"Machine: {machine()}; one thread. Other jobs ran beside it: times are of the processor, "
        "of searches those of the fastest tenth, and their ratios count. The first "
        f"{made['shipped']:,} vectors are those of the shipped index, all others copies of them "
        "with Gaussian noise of 3 steps (of 1/8) on each of the 48 values: two copies are about 29 "
        f"steps apart, neighbours in the shipped index {made['neighbour_steps']:.0f} (median). "
        "Such noise fills all 48 dimensions, as new poses would not, so that the recall above "
        "their number is a rough guide. "
        f"Queries: {made['queries']} silhouettes of entries, degraded "
        "(`index/build/noise.py`), and their mirror images.",
        "## By size",
        "Milliseconds of a search for one silhouette and its mirror image, k = 160; recall of the "
        "true nearest, and of the true nearest 150. Memory and load are those of the search alone; "
        "a flat search is made from the vectors at load and has no file of its own.",
        table(
            ["entries", "search", "ms", "first found", "150 found", "memory (MiB)", "file (MB)",
             "build (s)", "load (s)"],
            [row for size in sizes for row in _rows_of(figures, size)],
        ),
        "![searches](embedded-index.png)",
        "## Time for recall",
        table(
            ["entries", "search", "ms", "first found", "150 found"],
            [
                [f"{size:,}", _name(kind, setting), f"{setting['ms']:.2f}", *_recalls(setting)]
                for size in sizes
                for kind in ("ivf", "hnsw")
                for setting in figures.get(f"{kind}-{size}", {"settings": []})["settings"]
            ],
        ),
        "## What it does to answers",
        "The shipped index, the same queries. The first hypothesis beside that of the flat search, "
        "and the joints of the first and of the best of seven beside the true ones, pelvis on "
        "pelvis; in the order of descriptors, before the service ranks by keypoints. "
        "Keypoints are the true limbs with 3 px of noise. A person asks for "
        f"{vectors['silhouette']:.1f} vectors a search without keypoints (wide silhouettes are "
        f"rotated, each comes with its mirror image), for {vectors['keypoints']:.1f} with.",
        table(
            ["evidence", "search", "same first", "apart (mm)", "3D first (mm)",
             "3D best of 7 (mm)"],
            [
                [row["evidence"], row["search"], f"{100 * row['same_first']:.1f} %",
                 f"{row['apart_mm']:.1f}", f"{row['first_mm']:.1f}", f"{row['best_mm']:.1f}"]
                for row in figures["answers"]["rows"]
            ],
        ),
        f"## One core within {WITHIN_MS:.0f} ms",
        "A person with keypoints: the search by descriptors, scaled from two vectors to as many as "
        "above, and the search by landmarks, which compares 48 bytes of every entry.",
        table(
            ["entries", *(f"{kind} (ms)" for kind in DEFAULTS), "landmarks (ms)"],
            [
                [f"{size:,}", *(_ms(_person_ms(figures, kind, size)) for kind in DEFAULTS),
                 _ms(figures[f"landmarks-{size}"]["ms"])]
                for size in sizes
            ],
        ),
        _capacity(figures, sizes),
        "## Memory of everything else",
        _memory(figures["memory"]),
    ]  # fmt: skip
    plot(figures, sizes, out / "embedded-index.png")
    write(out, "embedded-index", command, text, {"machine": machine(), **figures})


def plot(figures: Figures, sizes: Sequence[int], file: Path) -> None:
    """Draw time and recall over the number of entries."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    for kind, setting in DEFAULTS.items():
        points = [(size, found) for size in sizes if (found := _default(figures, kind, size))]
        label = " ".join([kind, *(f"{key}={value}" for key, value in setting.items())])
        entries = [size for size, _ in points]
        left.loglog(entries, [found["ms"] for _, found in points], marker="o", label=label)
        if kind != "flat":
            for key, style, what in (("recall_first", "-", "first"), ("recall_150", "--", "150")):
                right.semilogx(
                    entries, [100 * found[key] for _, found in points], style, marker="o",
                    color=left.lines[-1].get_color(), label=f"{kind}, {what}",
                )  # fmt: skip
    by_landmarks = [figures[f"landmarks-{size}"]["ms"] for size in sizes]
    left.loglog(sizes, by_landmarks, ":", marker=".", color="gray", label="by landmarks")
    left.set(xlabel="entries", ylabel="ms a search (2 vectors, k = 160)")
    right.set(xlabel="entries", ylabel="recall (%)", ylim=(96.5, 100.3))
    for axes, place in ((left, "upper left"), (right, "lower left")):
        axes.legend(loc=place, fontsize="small")
        axes.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
    plt.close(figure)


def _rows_of(figures: Figures, size: int) -> list[list[str]]:
    rows = []
    for kind in DEFAULTS:
        case, built = figures.get(f"{kind}-{size}"), figures.get(f"{kind}-{size}-build")
        found = _default(figures, kind, size)
        if case is None or found is None:
            continue
        rows.append(
            [
                f"{size:,}", _name(kind, found), f"{found['ms']:.2f}", *_recalls(found),
                f"{case['mib']:,.0f}", f"{built['bytes'] / 1e6:,.1f}" if built else "-",
                f"{built['build_s']:,.1f}" if built else "-", f"{case['load_s']:.2f}",
            ]
        )  # fmt: skip
    return rows


def _default(figures: Figures, kind: str, size: int) -> dict[str, Any] | None:
    """Figures of a search at its default setting, or at the nearest that the size has."""
    case: dict[str, Any] | None = figures.get(f"{kind}-{size}")
    if case is None or kind == "flat":
        return case
    (key, value), *_ = DEFAULTS[kind].items()
    settings: list[dict[str, Any]] = case["settings"]
    return min(settings, key=lambda setting: abs(int(setting[key]) - value))


def _person_ms(figures: Figures, kind: str, size: int) -> float | None:
    """Time of a search by descriptors for a person with keypoints."""
    found = _default(figures, kind, size)
    vectors: float = figures["answers"]["vectors_a_search"]["keypoints"]
    return None if found is None else found["ms"] / 2 * vectors


def _within(sizes: Sequence[int], times: Sequence[float], limit_ms: float = WITHIN_MS) -> str:
    """How many entries take ``limit_ms``, on the line through the logarithms."""
    ascending = np.maximum.accumulate(times)
    if ascending[-1] < limit_ms:
        return f"more than {sizes[-1] / 1e6:.0f} million"
    entries = np.exp(np.interp(np.log(limit_ms), np.log(ascending), np.log(sizes)))
    return f"{entries / 1e6:.1f} million" if entries >= 1e6 else f"{entries / 1e3:.0f} thousand"


def _saved(figures: Figures, sizes: Sequence[int], vectors: float) -> str:
    """From how many entries on inverted lists save :data:`WORTH_MS` of a person's search."""
    both = [[_default(figures, kind, size) for size in sizes] for kind in ("flat", "ivf")]
    saved = [
        max(flat["ms"] - lists["ms"], 1e-3) / 2 * vectors
        for flat, lists in zip(*both, strict=True)
        if flat is not None and lists is not None
    ]
    return _within(sizes, saved, WORTH_MS)


def _capacity(figures: Figures, sizes: Sequence[int]) -> str:
    lines = []
    for kind in DEFAULTS:
        measured = [size for size in sizes if f"{kind}-{size}" in figures]
        found = [_default(figures, kind, size) for size in measured]
        two = [one["ms"] for one in found if one is not None]
        person = [_person_ms(figures, kind, size) or 0.0 for size in measured]
        both = [
            ms + figures[f"landmarks-{size}"]["ms"]
            for ms, size in zip(person, measured, strict=True)
        ]
        lines.append([kind, *(_within(measured, times) for times in (two, person, both))])
    vectors = figures["answers"]["vectors_a_search"]["keypoints"]
    alone = _within(sizes, [figures[f"landmarks-{size}"]["ms"] for size in sizes])
    return (
        table(
            ["search", "silhouette alone", "with keypoints", "with the search by landmarks"], lines
        )
        + f"\n\nThe search by landmarks alone takes {WITHIN_MS:.0f} ms at {alone} entries. "
        f"Inverted lists save {WORTH_MS:.0f} ms a person from {_saved(figures, sizes, 2)} entries "
        "on where an upright silhouette is all, "
        f"from {_saved(figures, sizes, vectors)} with keypoints."
    )


def _memory(memory: Figures) -> str:
    parts = memory["bytes"]
    rows = [[name, f"{size:.0f}"] for name, size in parts.items()]
    return (
        table(["part", "bytes an entry"], [*rows, ["together", f"{sum(parts.values()):.0f}"]])
        + f"\n\nAn index of {memory['entries']:,} entries keeps "
        f"{memory['resident_bytes_with_flat_search']:.0f} bytes an entry resident, the flat search "
        "(48) included."
    )


def _name(kind: str, setting: Figures) -> str:
    keys = [key for key in ("nprobe", "ef_search") if key in setting]
    return " ".join([kind, *(f"{key}={setting[key]}" for key in keys)])


def _recalls(found: Figures) -> list[str]:
    return [f"{100 * found.get(key, 1):.1f} %" for key in ("recall_first", "recall_150")]


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
