"""The page of ``make bench``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scripts.results import machine, revision

READY_WANTED_S, MEMORY_WANTED_MB = 2, 300


@dataclass(frozen=True)
class Row:
    """A line of the table; for what is wanted see :class:`scripts.load.benchmark_cases.Case`."""

    what: str
    milliseconds: list[float]
    people: str = ""
    wanted_ratio: float | None = None

    @property
    def median(self) -> float:
        """Median in milliseconds."""
        return float(np.median(self.milliseconds))

    def markdown(self, yardstick_ms: float) -> str:
        """Write the line; ratios are multiples of the yardstick's median."""
        cells = [
            self.what,
            self.people,
            f"{np.percentile(self.milliseconds, 10):.1f} ms",
            f"{self.median:.1f} ms",
            f"{self.median / yardstick_ms:.3f}",
            "" if self.wanted_ratio is None else f"{self.wanted_ratio:.2f}",
        ]
        return f"| {' | '.join(cells)} |"


@dataclass(frozen=True)
class Measured:
    """What a run of the benchmark found.

    ``stolen`` is the share of the processors' time that the host of a virtual machine gave to
    others; memory is resident, after the requests and at the most.
    """

    yardstick: Row
    rows: list[Row]
    stolen: float
    index: str
    ready_s: float
    memory_mb: float
    most_memory_mb: float


def report(measured: Measured, command: str, left_out: Sequence[str]) -> str:
    """Write the page in Markdown, with sentences on what was left out and why."""
    yardstick_ms = measured.yardstick.median
    rows = [row.markdown(yardstick_ms) for row in [measured.yardstick, *measured.rows]]
    return f"""# `make bench`

`{command}`, revision {revision()}.
Machine: {machine()}; its host gave {measured.stolen:.0%} of the processors' time to others.
Index: {measured.index}.

Whole requests over a real socket, {len(measured.yardstick.milliseconds)} of each kind \
and the yardstick as often, in turns. *Target*: the ratio to the yardstick that is aimed at; the \
benchmark does not fail where it is missed.

| | people found | fastest tenth within | median | median over yardstick's | target |
|---|---|---|---|---|---|
{chr(10).join(rows)}

Ready {measured.ready_s:.2f} s after the start (target: {READY_WANTED_S} s); \
{measured.memory_mb:.0f} MB resident after the requests (target: {MEMORY_WANTED_MB} MB), \
{measured.most_memory_mb:.0f} MB at the most.
{"".join(f"{chr(10)}Left out: {reason}.{chr(10)}" for reason in left_out)}"""
