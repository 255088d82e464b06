"""What an index could answer: how near its best entry is to each query of the strict experiment.

Matching can hardly return a pose that no entry is near to. Where few queries have an entry within
5 px, entries are missing rather than a better search.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from index.build.avatars import HELD_OUT_AVATARS, make_avatars
from index.build.builder import Asked, simulate_queries
from index.build.calibrate import Queries, run_trial
from index.build.motion import read_manifest
from index.confidence import RIGHT_BELOW_PX
from index.skeleton import JOINTS, mirror_normalised
from index.store import PoseIndex
from scripts.experiments.report import table, write
from scripts.experiments.strict import (
    QUERY_SEED,
    hold_out,
    posture_groups,
    strict_index,
    true_postures,
)

COMMAND = "python -m scripts.evaluate coverage"
ASKED = Asked(upright=500, near_ground=500, laid_down=300)
EVERY = (4, 2, 1)
"""Every fourth pose of the index, every second one, and all."""

COLUMNS = (*(f"covered by 1/{every} of the poses" for every in EVERY[:-1]), "covered by all")

COMPARED = 4000
"""Entries nearest by the root mean square over the joints, of which the mean errors are taken."""


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add no options."""


def run(options: argparse.Namespace) -> None:
    """Measure, and write ``coverage.md`` and ``coverage.json``."""
    coverage(options.shared, options.out, options.strict_index)


def coverage(shared: Path, out: Path, folder: Path | None) -> None:
    """Compare what is answered with the nearest entries, by posture and by size of the index."""
    motion = shared / "mocap"
    index = strict_index(shared, folder)
    _, held = hold_out(read_manifest(motion))
    avatars = make_avatars(HELD_OUT_AVATARS, shared / "garments")
    simulated = simulate_queries(motion, held, avatars, ASKED, QUERY_SEED)
    queries = Queries.of(simulated)
    answered = run_trial(index, queries, progress=True).right.any(axis=1)
    covered = nearest_entries_px(index, queries.joints_2d) < RIGHT_BELOW_PX
    rows, figures = [], {}
    for name, some in posture_groups(true_postures(simulated)).items():
        shares = [100 * float(within[some].mean()) for within in (answered, *covered)]
        figures[name] = dict(zip(("answered", *COLUMNS), shares, strict=True))
        rows.append([f"{name} ({some.sum()})", *(f"{share:.1f} %" for share in shares)])
    text = [
        "How far the entries reach",
        f"Index of the [strict experiment](strict.md), {len(index):,} entries; "
        f"{len(queries):,} of its queries ({ASKED.upright:,} of upright motion, "
        f"{ASKED.near_ground:,} of clips near the ground, {ASKED.laid_down:,} laid down). "
        "*Answered*: one of seven hypotheses is right, interpolated as the service does. "
        f"*Covered*: some entry, or its mirror image, lies within {RIGHT_BELOW_PX:g} px of the "
        "query's true joints.",
        table(["queries", "answered", *COLUMNS], rows),
        "Matching finds nearly all that the entries hold: what low postures lack is entries, and "
        "sitting, which hardly gains by more of them, recordings. Who sits or crouches is also "
        "enlarged to the same 128 px as who stands: 5 px are 4 cm there for 7 cm.",
    ]
    write(out, "coverage", COMMAND, text, {"share_of_queries": figures})


def nearest_entries_px(index: PoseIndex, joints_2d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean joint errors ``(len(EVERY), Q)`` of the entries nearest to joints ``(Q, 19, 2)``.

    Among the entries of every fourth pose of an index, of every second one, and of all.
    """
    _, own = index.points(np.arange(len(index)))
    points = np.concatenate([own, mirror_normalised(own)])[:, :JOINTS].astype(np.float32)
    pose = np.tile(index.entries["skeleton"], 2)
    parts = [np.flatnonzero(pose % every == 0) for every in EVERY]
    flat = points.reshape(len(points), -1)
    squares = (flat**2).sum(axis=1)
    errors = np.empty((len(EVERY), len(joints_2d)))
    for column, joints in enumerate(tqdm(joints_2d.astype(np.float32), desc="comparing")):
        apart = squares - 2 * (flat @ joints.ravel())
        for row, part in enumerate(parts):
            count = min(COMPARED, len(part))
            near = part[np.argpartition(apart[part], count - 1)[:count]]
            errors[row, column] = np.linalg.norm(points[near] - joints, axis=-1).mean(axis=1).min()
    return errors
