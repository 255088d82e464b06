"""Simulate a day of many cameras: replicas, answers in time, memory and cost.

    python -m scripts.simulate_load [--cameras 100000] [--price 0.04] [--write]

Costs of frames, sessions and the index are read from ``docs/results/coefficients.json``, where each
has its source. Two days are compared: cameras send all the time, or only while somebody is in view.
Then one thing after the other is changed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scripts.capacity.coefficients import PATH, Coefficients, read_coefficients
from scripts.capacity.day import HOURS, Day, Load, Replicas, simulate
from scripts.experiments.report import table, write
from scripts.results import ROOT

OUT = ROOT / "docs" / "results"
NAME = "load-day"
ALL_THE_TIME, WHEN_BUSY = "all the time", "while somebody is in view"
GBIT = 1e9 / 8


def figures(day: Day, replicas: Replicas, costs: Coefficients, price: float) -> dict[str, float]:
    """Sum up a day.

    Parameters
    ----------
    day : Day
    replicas : Replicas
    costs : Coefficients
    price : float
        Of a core for an hour.
    """
    process_mb = replicas.memory_mb + costs.process_mb(replicas.entries) - costs.resident_mb
    core_hours = day.core_hours(replicas)
    return {
        "frames_millions": float(day.sent.sum()) * 60 / 1e6,
        "frames_per_s_most": float(day.sent.max()),
        "cores_busy_mean": float(day.cores.mean()),
        "cores_busy_most": float(day.cores.max()),
        "replicas_least": int(day.replicas.min()),
        "replicas_most": int(day.replicas.max()),
        "sessions_most": float(day.sessions.max()),
        "memory_gb_most": float(day.replicas.max()) * process_mb / 1000,
        "gbit_per_s_most": float(day.sent.max()) * costs.frame_kb * 1000 / GBIT,
        "answered": day.overall(day.answered),
        "in_time": day.overall(day.in_time),
        "in_time_worst_minute": float(np.nanmin(day.in_time)),
        "refused": day.overall(day.refused),
        "superseded": day.overall(day.superseded),
        "searched": day.overall(day.searched),
        "begun_per_s_most": float(day.begun.max()),
        "core_hours": core_hours,
        "cost": core_hours * price,
    }


ROWS = {
    "frames, millions": ("frames_millions", "{:,.0f}"),
    "frames a second, most": ("frames_per_s_most", "{:,.0f}"),
    "frames searched as a whole": ("searched", "{:.0%}"),
    "cameras that start afresh, a second, most": ("begun_per_s_most", "{:,.0f}"),
    "cores kept busy, mean": ("cores_busy_mean", "{:,.0f}"),
    "cores kept busy, most": ("cores_busy_most", "{:,.0f}"),
    "replicas, least": ("replicas_least", "{:,}"),
    "replicas, most": ("replicas_most", "{:,}"),
    "camera sessions, most": ("sessions_most", "{:,.0f}"),
    "memory of replicas, GB, most": ("memory_gb_most", "{:,.0f}"),
    "network, Gbit/s, most": ("gbit_per_s_most", "{:,.1f}"),
    "**answered within 1 s**": ("in_time", "{:.1%}"),
    "the same in the worst minute": ("in_time_worst_minute", "{:.1%}"),
    "answered": ("answered", "{:.1%}"),
    "refused: no room": ("refused", "{:.1%}"),
    "superseded by a newer frame": ("superseded", "{:.1%}"),
    "core-hours": ("core_hours", "{:,.0f}"),
    "**cost of the day**": ("cost", "{:,.0f}"),
}


def variations(load: Load, replicas: Replicas) -> dict[str, tuple[Load, Replicas]]:
    """Change one thing at a time."""
    return {
        "as above": (load, replicas),
        "a frame in two seconds": (replace(load, frames_per_s=load.frames_per_s / 2), replicas),
        "three times as many people": (replace(load, people=3 * load.people), replicas),
        "no bursts": (replace(load, bursts=0), replicas),
        "cores in use aimed at: 0.4": (load, replace(replicas, target=0.4)),
        "cores in use aimed at: 0.8": (load, replace(replicas, target=0.8)),
        "replicas of 4 cores": (
            load,
            replace(
                replicas, cores=4, memory_mb=replicas.memory_mb * 1.5,
                session_memory_mb=replicas.session_memory_mb * 2,
            ),
        ),
        "queue of 8": (load, replace(replicas, queue=8)),
        "a replica serves after 10 minutes": (load, replace(replicas, start_s=600.0)),
        "a tenth of the memory for sessions": (
            load, replace(replicas, session_memory_mb=replicas.session_memory_mb / 10),
        ),
        "sessions kept for 30 s": (load, replace(replicas, idle_s=30.0)),
        "1,000,000 entries, flat": (load, replace(replicas, entries=1_000_000)),
    }  # fmt: skip


def draw(days: dict[str, Day], replicas: Replicas, path: Path) -> None:
    """Plot the days side by side: load, replicas, answers."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        3, len(days), figsize=(11, 8.5), sharex=True, sharey="row", squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for column, (name, day) in enumerate(days.items()):
        top, middle, bottom = axes[:, column]
        top.set_title(f"Cameras send {name}")
        top.plot(HOURS, day.sent / 1000, "C0", label="frames sent, thousands a second")
        top.plot(HOURS, day.sessions / 1000, "C2--", label="camera sessions, thousands")
        middle.plot(HOURS, day.replicas * replicas.cores, "C1", label="cores of replicas")
        middle.plot(HOURS, day.cores, "C3", lw=0.8, label="cores kept busy")
        bottom.plot(HOURS, 100 * day.in_time, "C0", lw=0.8, label="answered within 1 s")
        bottom.plot(HOURS, 100 * day.superseded, "C4", lw=0.8, label="superseded")
        bottom.plot(HOURS, 100 * day.refused, "C3", lw=0.8, label="refused")
        bottom.set_xlabel("hour of the day")
        bottom.set_xticks(range(0, 25, 3))
        bottom.set_ylim(0, 102)
    labels = {"thousands": "center", "cores": "lower right", "% of frames": "center"}
    for row, (label, free) in zip(axes, labels.items(), strict=True):
        row[0].set_ylabel(label)
        row[0].legend(loc=free, fontsize=9)
        for axis in row:
            axis.grid(alpha=0.3)
            axis.set_ylim(bottom=0)
            axis.set_xlim(0, 24)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    load, replicas = Load(), Replicas()
    parser.add_argument("--cameras", type=int, default=load.cameras)
    parser.add_argument("--rate", type=float, default=load.frames_per_s, help="frames a second")
    parser.add_argument("--people", type=float, default=load.people, help="where there are any")
    parser.add_argument("--cores", type=int, default=replicas.cores, help="of a replica")
    parser.add_argument("--entries", type=int, default=replicas.entries, help="of the index")
    parser.add_argument("--index", default=replicas.index, help="its kind")
    parser.add_argument("--price", type=float, default=0.04, help="of a core for an hour")
    parser.add_argument("--sample", type=int, default=10, help="replicas simulated frame by frame")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--coefficients", type=Path, default=PATH)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--write", action="store_true", help=f"{NAME}.md, .json and .png")
    options = parser.parse_args(arguments)
    try:
        run(options)
    except ValueError as error:
        raise SystemExit(f"simulate_load: {error}") from None


def run(options: argparse.Namespace) -> None:
    """Simulate, print, and write where that is asked."""
    costs = read_coefficients(options.coefficients)
    load = Load(options.cameras, options.rate, people=options.people)
    replicas = Replicas(options.cores, entries=options.entries, index=options.index)

    def day_of(load: Load, replicas: Replicas) -> tuple[Day, dict[str, float]]:
        day = simulate(load, replicas, costs, sample=options.sample, seed=options.seed)
        return day, figures(day, replicas, costs, options.price)

    gated = replace(load, gated=True)
    days, summed = {}, {}
    for name, what in {ALL_THE_TIME: load, WHEN_BUSY: gated}.items():
        days[name], summed[name] = day_of(what, replicas)
    columns = [
        [words.format(values[key]) for key, words in ROWS.values()] for values in summed.values()
    ]
    rows = [
        *(list(row) for row in zip(ROWS, *columns, strict=True)),
        ["what asks for most replicas", *(day.bottleneck() for day in days.values())],
    ]
    changed = {}
    for name, (what, where) in variations(gated, replicas).items():
        day, values = day_of(what, where)
        changed[name] = {**values, "bottleneck": day.bottleneck()}
    header = ["", "replicas, most", "core-hours", "within 1 s", "worst minute", "refused", "limit"]
    varied = [
        [
            name,
            f"{values['replicas_most']:,}",
            f"{values['core_hours']:,.0f}",
            f"{values['in_time']:.1%}",
            f"{values['in_time_worst_minute']:.1%}",
            f"{values['refused']:.1%}",
            str(values["bottleneck"]),
        ]
        for name, values in changed.items()
    ]
    command = (
        f"python -m scripts.simulate_load --cameras {options.cameras} --rate {options.rate:g} "
        f"--people {options.people:g} --price {options.price:g} --sample {options.sample} --write"
    )
    paragraphs = [
        f"A day of {options.cameras:,} cameras, simulated",
        f"""Each camera sends {options.rate:g} frames a second of 768x576, all the time or only
while somebody is in view; then {options.people:g} people on average. Replicas of
{replicas.cores} cores let {replicas.queue} frames wait. The autoscaler aims at
{replicas.target:.0%} of the cores in use, or at what the sessions need where that is more; a
replica serves {replicas.start_s:g} s after it is wanted and goes {replicas.down_s:g} s after it no
longer is. A core costs {options.price:g} an hour. What frames and sessions cost is
[measured](coefficients.json); what the cameras see is made up.""",
        table(["cameras send", *days], rows),
        f"![The day by the hour]({NAME}.png)",
        f"One thing changed at a time, cameras that send {WHEN_BUSY}:",
        table(header, varied),
        f"""Fates of frames are those of {options.sample} replicas simulated frame by frame, each
with the cameras that chance has given it. The autoscaler of the simulation knows what sessions
need; one that looks at processor time alone does not, and the service then drops the sessions used
least lately. Not simulated: failures, the network, the balancers, and idle cores that help with a
frame's people, by which the service is sooner than this under light load.""",
    ]
    print("\n\n".join(paragraphs))
    if options.write:
        write(options.out, NAME, command, paragraphs, {"days": summed, "changed": changed})
        draw(days, replicas, options.out / f"{NAME}.png")


if __name__ == "__main__":
    main()
