"""The command line of the measures of one network on real people."""

from __future__ import annotations

import argparse
from pathlib import Path

from app.settings import DEFAULT_MODELS

ROOT = Path(__file__).resolve().parents[2]


def read_options(description: str | None, weights: Path) -> argparse.Namespace:
    """Read where the data, the networks and the halves of the photographs are."""
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--models", type=Path, default=DEFAULT_MODELS, help="of fetch_models")
    parser.add_argument("--network", type=Path, default=weights, help="the one judged")
    parser.add_argument("--step", type=int, default=4, help="every so many-th frame of pose2sim")
    parser.add_argument("--odd", action="store_true", help="the odd photographs, and pose2sim")
    return parser.parse_args()
