"""Build an index from motion capture: ``make index``, on this machine or a Dask cluster."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from index import DEFAULT_PATH
from index.artefact import check_replaceable, save_index
from index.build.builder import CMU_ATTRIBUTION, Plan, build
from index.build.shard_files import ShardError
from index.build.workers import Threads, Workers, WorkersError
from index.folders import staging
from scripts.results import SHARED


def main(arguments: Sequence[str] | None = None) -> None:
    """Build and save as the command line asks."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--mocap", type=Path, default=SHARED / "mocap", help="has manifest.csv and bvh/")
    add("--garments", type=Path, help="MakeHuman garments; without them bodies are unclothed")
    add("--out", type=Path, default=DEFAULT_PATH, help="folder of the index; replaced if it is one")
    add("--name", help="of the index; by default that of its folder")
    add(
        "--attribution",
        default="",
        metavar="SENTENCE",
        help="whose the motion is; cmu stands for that of ../shared/mocap",
    )
    add("--entries", type=int, default=Plan.entries)
    add("--bodies", type=int, default=Plan.bodies, help="bodies per pose")
    add("--views", type=int, default=Plan.views, help="views per pose and body")
    add("--seed", type=int, default=Plan.seed)
    add("--descriptor", choices=("discriminant", "paper"), default=Plan.descriptor)
    add("--scheduler", metavar="ADDRESS", help="of a Dask cluster that draws; tcp://HOST:8786")
    add(
        "--shards",
        type=Path,
        metavar="FOLDER",
        help="keeps what is drawn, so that a build can be resumed, and is shared by a cluster; "
        "by default a temporary folder beside --out",
    )
    options = parser.parse_args(arguments)
    name = options.name or options.out.resolve().name
    attribution = CMU_ATTRIBUTION if options.attribution == "cmu" else options.attribution
    plan = Plan(
        entries=options.entries,
        bodies=options.bodies,
        views=options.views,
        seed=options.seed,
        descriptor=options.descriptor,
    )
    inputs = {"--mocap": options.mocap, "--garments": options.garments}
    check_apart(options.out, {**inputs, "--shards": options.shards})
    check_replaceable(options.out)
    out = options.out.resolve()
    shards = nullcontext(options.shards) if options.shards else staging(out)
    try:
        with _workers(options.scheduler) as workers:
            index = build(
                options.mocap, options.garments, plan, name=name, attribution=attribution,
                workers=workers, shards=shards, progress=True, say=print,
            )  # fmt: skip
    except (ShardError, WorkersError) as error:
        raise SystemExit(f"build: {error}") from None
    version = save_index(index, options.out)
    print(f"{len(index)} entries in {options.out}, {version}")


def check_apart(out: Path, others: Mapping[str, Path | None]) -> None:
    """Raise a ``ValueError`` if ``out`` is, holds or lies in another folder, by its option."""
    resolved = out.resolve()
    for option, folder in others.items():
        if folder is None:
            continue
        other = folder.resolve()
        if resolved.is_relative_to(other) or other.is_relative_to(resolved):
            raise ValueError(
                f"--out: expected a folder apart from {option}, since it is replaced as a whole, "
                f"got {out} and {folder}"
            )


def _workers(scheduler: str | None) -> AbstractContextManager[Workers]:
    if scheduler is None:
        return nullcontext(Threads())
    try:
        from index.build.cluster import Cluster
    except ModuleNotFoundError as error:
        raise WorkersError(f"--scheduler needs the extra cluster ({error})") from error
    return Cluster(scheduler)
