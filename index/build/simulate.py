"""Poses x bodies x views to silhouettes with their skeletons."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import Descriptor
from index.build.body import Avatar, Retargeting, pose_transforms, retarget
from index.build.parameters import RENDERING
from index.build.poses import Poses
from index.build.shard_files import (
    code_version,
    read_shard,
    render_shard,
    shard_name,
    write_avatars,
)
from index.build.views import Shard
from index.silhouettes import Silhouettes, sampled
from index.store import SKELETON_DTYPE

BLOCK = 4096
"""Silhouettes unpacked and described at a time."""


Result = TypeVar("Result")


@dataclass(frozen=True)
class Simulation:
    """Simulated silhouettes and where each comes from; fields as in :class:`index.store.PoseIndex`.

    Parameters
    ----------
    entries : (E,) array of ENTRY_DTYPE
    skeletons : (S, 24, 3) float16 array
    skeleton_labels : (S,) array of SKELETON_DTYPE
    """

    silhouette_store: Silhouettes
    entries: NDArray[np.void]
    skeletons: NDArray[np.float16]
    skeleton_labels: NDArray[np.void]
    clips: tuple[str, ...]
    subjects: tuple[str, ...]
    actions: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.entries)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Simulation:
        """Some entries; all skeletons stay."""
        return replace(
            self, silhouette_store=self.silhouette_store.select(rows), entries=self.entries[rows]
        )

    def silhouettes(self, rows: slice | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Unpack some silhouettes ``(B, 128, 48)`` of 0 and 1."""
        return self.silhouette_store.take(np.arange(len(self))[rows])

    def describe(self, descriptor: Descriptor) -> NDArray[np.float32]:
        """All silhouettes as vectors ``(E, D)``, block by block."""
        blocks = [
            descriptor.describe(self.silhouettes(slice(start, start + BLOCK)))
            for start in range(0, len(self), BLOCK)
        ]
        return np.concatenate(blocks)


def simulate(
    poses: Poses,
    avatars: Sequence[Avatar],
    *,
    bodies: int,
    views: int,
    seed: int,
    only_new: bool = False,
    progress: bool = False,
    executor: Executor | None = None,
    folder: Path | None = None,
) -> Simulation:
    """Render every pose on some bodies from some views, shard by shard.

    Parameters
    ----------
    avatars : sequence of Avatar
        Dealt out in turn, so that each gets its share of the poses.
    bodies : int
        Bodies per pose.
    views : int
        Views per pose and body.
    seed : int
        The same seed, poses and avatars give the same bytes, whatever the executor.
    only_new : bool
        Whether poses laid down are seen along the trunk only: seen across, they look like
        standing ones.
    progress : bool
        Whether to show a progress bar.
    executor : Executor, optional
        Renders the shards; by default threads of this process.
    folder : Path, optional
        Where the shards are written and stay; those that are there already are not rendered
        again. By default a temporary folder.

    Returns
    -------
    Simulation
        Entries pose by pose, body by body, view by view.

    Raises
    ------
    ShardError
        If a shard cannot be rendered or read.
    """
    bodies = min(bodies, len(avatars))
    assigned = assign_avatars(len(poses) * bodies, len(avatars), seed)
    shards = _shards(poses, avatars, assigned, views, seed, only_new)
    with (
        nullcontext(folder) if folder else TemporaryDirectory() as where,
        nullcontext(executor) if executor else ThreadPoolExecutor(os.cpu_count()) as pool,
    ):
        files = _render_missing(shards, len(assigned), avatars, Path(where), pool, progress)
        store, entries, skeletons = _merge(files, len(assigned) * views)
    rows = np.repeat(np.arange(len(poses)), bodies)
    labels = np.zeros(len(assigned), SKELETON_DTYPE)
    labels["clip"], labels["frame"] = poses.clip[rows], poses.frame[rows]
    labels["subject"], labels["action"] = assigned, poses.action[rows]
    labels["speed"] = poses.speeds()[rows]
    return Simulation(
        store, entries, skeletons, labels,
        tuple(clip.name for clip in poses.clips), tuple(a.name for a in avatars), poses.actions,
    )  # fmt: skip


def assign_avatars(count: int, avatars: int, seed: int) -> NDArray[np.int64]:
    """Position of the avatar of each of ``count`` bodies; each avatar is as frequent as others."""
    generator = np.random.default_rng(seed)
    rounds = [generator.permutation(avatars) for _ in range(-(-count // avatars))]
    return np.concatenate(rounds)[:count]


def _shards(
    poses: Poses,
    avatars: Sequence[Avatar],
    assigned: NDArray[np.int64],
    views: int,
    seed: int,
    only_new: bool,
) -> Iterator[Shard]:
    bodies = len(assigned) // len(poses)

    @cache
    def retargeting(clip: int, avatar: int) -> Retargeting:
        return retarget(poses.clips[clip], avatars[avatar])

    def transforms(number: int) -> NDArray[np.float64]:
        row, avatar = number // bodies, int(assigned[number])
        rotations = poses.rotations(np.array([row]))
        retargeted = retargeting(int(poses.clip[row]), avatar)
        return pose_transforms(avatars[avatar], retargeted, rotations)[0]

    for start in range(0, len(poses), RENDERING.shard_poses):
        rows = np.arange(start, min(start + RENDERING.shard_poses, len(poses)))
        numbers = range(bodies * start, bodies * (rows[-1] + 1))
        yield Shard(
            first=numbers.start,
            avatar=assigned[numbers.start : numbers.stop],
            transforms=np.stack([transforms(number) for number in numbers]),
            foreshortened=np.repeat(only_new & ~np.isnan(poses.lying_deg[rows]), bodies),
            views=views,
            seed=seed,
        )


def _render_missing(
    shards: Iterator[Shard],
    bodies: int,
    avatars: Sequence[Avatar],
    folder: Path,
    executor: Executor,
    progress: bool,
) -> list[Path]:
    """Render the shards that have no file yet, and return the files of all, in order."""
    # Workers may run in other folders.
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    avatar_file, code = write_avatars(avatars, folder), code_version()
    files = []
    with tqdm(total=bodies, unit="body", desc="simulating", disable=not progress) as bar:

        def missing() -> Iterator[tuple[Shard, Path, Path, str]]:
            for shard in shards:
                file = folder / shard_name(shard, avatar_file, code)
                files.append(file)
                if file.exists():
                    bar.update(len(shard))
                else:
                    yield shard, avatar_file, file, code

        for rendered in bounded_map(executor, render_shard, missing()):
            bar.update(rendered)
    return files


def bounded_map(
    executor: Executor,
    function: Callable[..., Result],
    tasks: Iterable[tuple[Any, ...]],
    max_pending: int = RENDERING.max_pending,
) -> Iterator[Result]:
    """Call a function with each task's arguments; results in order, ``max_pending`` at a time.

    :meth:`concurrent.futures.Executor.map` would take all tasks at once.
    """
    pending: deque[Future[Result]] = deque()
    try:
        for task in tasks:
            pending.append(executor.submit(function, *task))
            if len(pending) == max_pending:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        for future in pending:
            future.cancel()


def _merge(
    files: Sequence[Path], count: int
) -> tuple[Silhouettes, NDArray[np.void], NDArray[np.float16]]:
    """Read shards one by one; return their silhouettes, compressed, entries and skeletons."""
    in_each = len(read_shard(files[0]).entries)
    sample = []
    wanted = sampled(count)
    for number in np.unique(wanted // in_each):
        rows = wanted[wanted // in_each == number] % in_each
        sample.append(read_shard(files[number]).bits[rows])
    dictionary = np.concatenate(sample)
    stores, entries, skeletons = [], [], []
    for file in files:
        shard = read_shard(file)
        stores.append(Silhouettes.compress(shard.bits, dictionary))
        entries.append(shard.entries)
        skeletons.append(shard.skeletons)
    return Silhouettes.joined(stores), np.concatenate(entries), np.concatenate(skeletons)
