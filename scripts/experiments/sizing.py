"""How to spend the entries of an index: on poses, on bodies or on views."""

from __future__ import annotations

import argparse
from pathlib import Path

from index.build.avatars import CALIBRATION_AVATARS, INDEX_AVATARS, make_avatars
from index.build.builder import Asked, assemble, choose_poses, simulate_queries, split_by_clip
from index.build.calibrate import Queries, run_trial
from index.build.learn import learn_descriptor
from index.build.motion import read_manifest
from index.build.poses import read_poses
from index.build.simulate import simulate
from index.confidence import Calibration
from scripts.experiments.report import table, write
from scripts.experiments.strict import hold_out, summary

COMMAND = "python -m scripts.evaluate sizing"
ENTRIES = 48_000
SHARES = ((1, 12), (2, 6), (2, 12), (2, 24), (4, 12))
"""Bodies per pose and views per body; poses fill the rest."""
ASKED = Asked(upright=700, near_ground=300, laid_down=200)
SEED = 7


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Nothing to set."""


def run(options: argparse.Namespace) -> None:
    """Build small indexes of one size and ask them for clips and bodies they do not hold."""
    sizing(options.shared, options.out)


def sizing(shared: Path, out: Path) -> None:
    """Write ``sizing.md`` and ``sizing.json``.

    The strict experiment's clips stay unseen: of the others, some are held out here.
    """
    motion, garments = shared / "mocap", shared / "garments"
    kept, held = split_by_clip(hold_out(read_manifest(motion))[0])
    avatars = make_avatars(INDEX_AVATARS, garments)
    asked = Queries.of(
        simulate_queries(motion, held, make_avatars(CALIBRATION_AVATARS, garments), ASKED, SEED)
    )
    poses, _ = read_poses(motion, kept)
    rows, figures = [], []
    for bodies, views in SHARES:
        chosen = choose_poses(poses, avatars[0], ENTRIES // (bodies * views), SEED)
        simulation = simulate(chosen, avatars, bodies=bodies, views=views, seed=SEED, progress=True)
        descriptor = learn_descriptor(simulation, SEED)
        index = assemble(simulation, descriptor, Calibration.none(), {}, "sizing")
        figure = summary(run_trial(index, asked, progress=True))
        figures.append({"poses": len(chosen), "bodies": bodies, "views": views, **figure})
        rows.append(
            [
                f"{len(chosen):,}", str(bodies), str(views), f"{figure['right_1']:.1f} %",
                f"{figure['right_7']:.1f} %", f"{figure['first_mm']:.0f}",
                f"{figure['best_mm']:.0f}",
            ]
        )  # fmt: skip
    text = [
        "Poses, bodies or views",
        f"{ENTRIES:,} entries each, spent differently. Queries: {len(asked):,} silhouettes of "
        f"{len({s.clip for s in held})} clips and 4 bodies that the indexes do not hold (none of "
        "them of the strict experiment).",
        table(
            ["poses", "bodies a pose", "views a body", "right at 1", "right within 7",
             "3D first (mm)", "3D best of 7 (mm)"],
            rows,
        ),
    ]  # fmt: skip
    write(out, "sizing", COMMAND, text, {"sizes": figures})
