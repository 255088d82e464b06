"""Build an index from motion capture: ``make index``, on this machine or a Dask cluster."""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from index import DEFAULT_PATH
from scripts.index.builder import CMU_ATTRIBUTION, IndexSpec, Plan, build
from scripts.index.writer import check_replaceable, save_index
from scripts.results import SHARED

CONNECT_S = 10
"""Seconds that a scheduler may take to answer."""


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
    add("--scheduler", metavar="ADDRESS", help="of a Dask cluster that renders; tcp://HOST:8786")
    options = parser.parse_args(arguments)
    name = options.name or options.out.resolve().name
    attribution = CMU_ATTRIBUTION if options.attribution == "cmu" else options.attribution
    check_apart(options.out, {"--mocap": options.mocap, "--garments": options.garments})
    check_replaceable(options.out)
    plan = Plan(
        entries=options.entries,
        bodies=options.bodies,
        views=options.views,
        seed=options.seed,
        descriptor=options.descriptor,
    )
    spec = IndexSpec(name, options.mocap, options.garments, plan, attribution)
    with ExitStack() as stack:
        executor = None
        if options.scheduler:
            from distributed import Client

            client = stack.enter_context(Client(options.scheduler, timeout=CONNECT_S))
            executor = client.get_executor(pure=False)
        index = build(spec, executor=executor)
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
