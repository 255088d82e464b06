"""The frame of every measurement of a server's reliability: command line, server, conclusion."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from index import DEFAULT_PATH
from index.artefact import load_index
from index.store import PoseIndex
from scripts import figures
from scripts.load.server import ServerProcess
from scripts.results import RESULTS, percentile

Figures = dict[str, Any]
Criteria = dict[str, bool]
"""Sentences with what was measured, and whether each meets its criterion."""

Measure = Callable[[ServerProcess, PoseIndex, Any], tuple[Figures, Criteria]]


def run(
    measure: Measure, section: str, option: str, default: float, arguments: Sequence[str] | None
) -> int:
    """Measure a server, print the section, write it where asked for; 1 if a criterion fails.

    ``option`` names how long or how much is measured.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--write", action="store_true", help="into docs/results/reliability")
    parser.add_argument(f"--{option}", dest="amount", type=type(default), default=default)
    options = parser.parse_args(arguments)
    with ServerProcess(options.index) as server:
        server.wait_until_ready()
        found, criteria = measure(server, load_index(options.index), options.amount)
    failed = [what for what, met in criteria.items() if not met]
    command = f"python -m scripts {section} --{option} {options.amount:.12g}"
    out = RESULTS if options.write else None
    figures.report_section(section, command, {**found, "failed": failed}, out)
    return 1 if failed else 0


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum."""
    return {
        "p50": percentile(values, 50),
        "p99": percentile(values, 99),
        "max": max(values, default=0.0),
    }
