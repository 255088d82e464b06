"""Build an index from motion capture: ``make index``, on this machine or a Dask cluster."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from index.artefact import check_replaceable, save_index
from index.build.builder import CMU_ATTRIBUTION, IndexSpec, Plan, build
from index.build.garments import GarmentError
from index.build.motion import MotionError
from index.build.shard_files import ShardError
from index.files import staging
from index.store import DEFAULT_PATH


def main() -> int:
    """Parse the command line, build, save; 1 with one sentence where that fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--mocap", type=Path, default=Path("../shared/mocap"), help="has manifest.csv and bvh/")
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
    arguments = parser.parse_args()
    name = arguments.name or arguments.out.resolve().name
    attribution = CMU_ATTRIBUTION if arguments.attribution == "cmu" else arguments.attribution
    inputs = {"--mocap": arguments.mocap, "--garments": arguments.garments}
    try:
        check_apart(arguments.out, {**inputs, "--shards": arguments.shards})
        check_replaceable(arguments.out)
        plan = Plan(
            entries=arguments.entries,
            bodies=arguments.bodies,
            views=arguments.views,
            seed=arguments.seed,
            descriptor=arguments.descriptor,
        )
        shards = (
            nullcontext(arguments.shards) if arguments.shards else staging(arguments.out.resolve())
        )
        spec = IndexSpec(name, arguments.mocap, arguments.garments, plan, attribution)
        with _executor(arguments.scheduler) as executor:
            index = build(spec, executor=executor, shards=shards, progress=True, log=print)
        version = save_index(index, arguments.out)
    except (MotionError, GarmentError, ShardError, ValueError, OSError) as error:
        print(f"build_index: {error}", file=sys.stderr)
        return 1
    print(f"{len(index)} entries in {arguments.out}, {version}")
    return 0


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


def _executor(scheduler: str | None) -> AbstractContextManager[Executor | None]:
    if scheduler is None:
        return nullcontext()
    try:
        from index.build.cluster import cluster_executor
    except ModuleNotFoundError as error:
        raise ShardError(f"--scheduler needs the extra cluster ({error})") from error
    return cluster_executor(scheduler)


if __name__ == "__main__":
    sys.exit(main())
