"""Command line and conclusion of every measurement of a server's reliability."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from index.store import DEFAULT_PATH
from scripts.experiments import pages
from scripts.results import RESULTS, machine, percentile, revision


def measurement_parser(description: str | None) -> argparse.ArgumentParser:
    """Make a command line with the options of every measurement."""
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--index", type=type(DEFAULT_PATH), default=DEFAULT_PATH)
    parser.add_argument("--write", action="store_true", help="into docs/results/reliability")
    return parser


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum."""
    return {
        "p50": percentile(values, 50),
        "p99": percentile(values, 99),
        "max": max(values, default=0.0),
    }


def conclude(
    section: str, command: str, figures: Mapping[str, Any], criteria: Mapping[str, bool],
    *, write: bool,
) -> int:  # fmt: skip
    """Print a section, write it where asked for, and return 1 if a criterion is not met."""
    failed = [what for what, met in criteria.items() if not met]
    figures = {**figures, "failed": failed}
    origin = {"command": command, "revision": revision(), "machine": machine()}
    print(pages.render_section(section, {**origin, **figures}))
    if write:
        pages.write_section(RESULTS, section, command, figures)
    return 1 if failed else 0
