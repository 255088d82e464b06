"""Run experiments; print the page of each, and write it and its figures into ``docs/results``.

    python -m scripts evaluate paper        the experiments of Atrevi et al. (2016)
    python -m scripts evaluate stages       what each step adds, from the paper's path on
    python -m scripts evaluate simulation   bodies, clips and views that the index never saw
    python -m scripts evaluate real         photographs and videos of ../shared/real
    python -m scripts evaluate confidence   how often hypotheses are right that are said to be
    python -m scripts evaluate people       people who fall, sit, lie, lean or do sport
    python -m scripts evaluate photographs  what rendered people taught, on real frames by source
    python -m scripts evaluate films        all real films as camera sessions: falls, false alarms

Without a name, all of them run.
"""

import argparse
import importlib
import time
from collections.abc import Sequence
from pathlib import Path

from scripts.figures import write
from scripts.results import RESULTS, SHARED

EXPERIMENTS = {
    "paper": "paper",
    "stages": "stages",
    "simulation": "simulation",
    "real": "real",
    "confidence": "confidence",
    "people": "people",
    "photographs": "photographs",
    "films": "films",
}
"""Page of each experiment. Its module in ``scripts.experiments`` is imported only when it runs; it
has ``run(options)``, which returns figures, and may have ``add_arguments(parser)``."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the experiments named on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="experiment", help=", ".join(EXPERIMENTS))
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument(
        "--strict-index",
        type=Path,
        metavar="FOLDER",
        help="keeps the index without the held-out clips for the next time",
    )
    known, _ = parser.parse_known_args(arguments)
    unknown = [name for name in known.names if name not in EXPERIMENTS]
    if unknown:
        parser.error(f"expected {', '.join(EXPERIMENTS)}, got {', '.join(unknown)}")
    names = known.names or list(EXPERIMENTS)
    modules = [importlib.import_module(f"scripts.experiments.{name}") for name in names]
    for name, module in zip(names, modules, strict=True):
        if hasattr(module, "add_arguments"):
            module.add_arguments(parser.add_argument_group(name))
    options = parser.parse_args(arguments)
    for name, module in zip(names, modules, strict=True):
        started = time.monotonic()
        try:
            figures = module.run(options)
        except FileNotFoundError as error:
            raise FileNotFoundError(f"{error}; --shared names the folder of data") from error
        if figures is not None:
            command = f"python -m scripts evaluate {name}"
            write(options.out, EXPERIMENTS[name], command, figures)
            print((options.out / f"{EXPERIMENTS[name]}.md").read_text())
        print(f"{name} took {(time.monotonic() - started) / 60:.1f} minutes")
