"""The experiments: what the service is measured by.

    python -m scripts.evaluate paper        the experiments of Atrevi et al. (2016)
    python -m scripts.evaluate simulation   bodies, clips and views that the index never saw
    python -m scripts.evaluate real         photographs and videos of ../shared/real
    python -m scripts.evaluate people       people who fall, sit, lie, lean or do sport
    python -m scripts.evaluate actions      actions, postures and falls of tracks
    python -m scripts.evaluate weizmann     actions in the Weizmann data set, as in the paper
    python -m scripts.evaluate tracking     people followed over the frames of a fixed camera

Without a name, all of them. Results and plots go to ``docs/results/``, each with its command.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

EXPERIMENTS = {
    "paper": "scripts.experiments.paper",
    "simulation": "scripts.experiments.strict",
    "real": "scripts.experiments.real",
    "people": "scripts.experiments.people",
    "actions": "scripts.experiments.actions",
    "weizmann": "scripts.experiments.weizmann_report",
    "tracking": "scripts.experiments.tracking",
}
"""Modules with ``add_arguments(parser)`` and ``run(options)``, imported only when asked for."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="experiment", help=", ".join(EXPERIMENTS))
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results")
    parser.add_argument(
        "--strict-index",
        type=Path,
        metavar="FOLDER",
        help="index without the held-out clips, kept here once it is built; by default "
        "whichever experiment needs it builds it anew",
    )
    parser.add_argument(
        "--weizmann",
        type=Path,
        metavar="FILE",
        help="classification_masks.mat of the Weizmann data set; by default that of --shared",
    )
    known, _ = parser.parse_known_args(arguments)
    unknown = [name for name in known.names if name not in EXPERIMENTS]
    if unknown:
        parser.error(f"expected {', '.join(EXPERIMENTS)}, got {', '.join(unknown)}")
    modules = [
        importlib.import_module(EXPERIMENTS[name]) for name in known.names or list(EXPERIMENTS)
    ]
    for module in modules:
        module.add_arguments(parser.add_argument_group(module.__name__.rsplit(".")[-1]))
    options = parser.parse_args(arguments)
    if options.weizmann is None:
        options.weizmann = options.shared / "real" / "weizmann" / "classification_masks.mat"
    for module in modules:
        started = time.monotonic()
        try:
            module.run(options)
            minutes = (time.monotonic() - started) / 60
            print(f"{module.__name__.rsplit('.')[-1]} took {minutes:.1f} minutes")
        except (FileNotFoundError, ValueError) as error:
            raise SystemExit(f"evaluate: {error}") from None


if __name__ == "__main__":
    main()
