"""How the answers improve as the index grows."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from index.build.avatars import HELD_OUT_AVATARS, INDEX_AVATARS, make_avatars
from index.build.builder import Plan, assemble, choose_poses, simulate_queries
from index.build.calibrate import Queries, run_trial
from index.build.learn import learn_descriptor
from index.build.motion import read_manifest
from index.build.poses import read_poses
from index.build.simulate import Simulation, simulate
from index.confidence import Calibration
from scripts.experiments.report import table, write
from scripts.experiments.strict import ASKED, QUERY_SEED, hold_out, summary
from scripts.experiments.strict_pictures import plot_growth

COMMAND = "python -m scripts.evaluate growth"
SIZES = (3_000, 12_000, 48_000, 120_000, 400_000)
EVERY = 4
"""Every fourth query of the strict experiment is asked here."""

Figures = dict[str, float]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Nothing to set."""


def run(options: argparse.Namespace) -> None:
    """Measure every size and write ``growth.md``, ``growth.json`` and ``growth.png``."""
    report(grow(options.shared), options.out)


def grow(shared: Path) -> list[Figures]:
    """The figures at each size of :data:`SIZES`; smaller indexes hold the first poses.

    Clips and bodies asked for are those of the strict experiment.
    """
    motion, garments = shared / "mocap", shared / "garments"
    kept, held = hold_out(read_manifest(motion))
    avatars = make_avatars(INDEX_AVATARS, garments)
    frames, _ = read_poses(motion, kept)

    def simulated(entries: int) -> Simulation:
        plan = replace(Plan(), entries=entries).fitted(len(frames))
        poses = choose_poses(frames, avatars[0], plan.poses, plan.seed)
        return simulate(
            poses, avatars, bodies=plan.bodies, views=plan.views, seed=plan.seed, progress=True
        )

    shipped = simulated(Plan.entries)
    strangers = make_avatars(HELD_OUT_AVATARS, garments)
    queries = Queries.of(simulate_queries(motion, held, strangers, ASKED, QUERY_SEED))
    asked = queries.take(np.arange(0, len(queries), EVERY))
    descriptor = learn_descriptor(shipped, Plan.seed)
    figures = []
    for size in tqdm(SIZES, desc="sizes", unit="index"):
        part = shipped.take(np.arange(size)) if size <= len(shipped) else simulated(size)
        index = assemble(part, descriptor, Calibration.none(), {}, "growth")
        figure = summary(run_trial(index, asked))
        del figure["ece"]  # These have no calibration.
        figures.append({"entries": len(part), **figure})
    return figures


def report(figures: Sequence[Figures], out: Path) -> None:
    """Write the page, the figures and the plot."""
    header = ["entries", "right at 1", "right within 7", "3D first (mm)", "3D best of 7 (mm)"]
    rows = [
        [
            f"{int(f['entries']):,}", f"{f['right_1']:.1f} %", f"{f['right_7']:.1f} %",
            f"{f['first_mm']:.0f}", f"{f['best_mm']:.0f}",
        ]
        for f in figures
    ]  # fmt: skip
    text = [
        "As the index grows",
        f"{int(figures[0]['queries'])} of the strict experiment's queries, whose clips and bodies "
        "no index holds. Each size holds the first poses of the next, chosen farthest first (of "
        "400,000 entries each pose on two bodies, for lack of more frames), and "
        f"all describe by one descriptor, learned at {Plan.entries:,} entries.",
        table(header, rows),
        "![growth](growth.png)",
    ]
    out.mkdir(parents=True, exist_ok=True)
    plot_growth(figures, out / "growth.png")
    write(out, "growth", COMMAND, text, {"sizes": list(figures)})
