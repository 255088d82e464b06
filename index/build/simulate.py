"""Poses x bodies x views to silhouettes with their skeletons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import Descriptor
from index.build.body import Avatar, Retargeting, pose_transforms, retarget
from index.build.poses import Poses
from index.build.shard_files import (
    Task,
    code_version,
    name_of,
    perform,
    read_drawn,
    write_avatars,
)
from index.build.views import Shard
from index.build.workers import Threads, Workers
from index.silhouettes import Silhouettes, sampled
from index.store import SKELETON_DTYPE

BLOCK = 4096
"""Silhouettes unpacked and described at a time."""

SHARD_POSES = 100
"""Poses drawn at a time: a second or two of work."""


@dataclass(frozen=True)
class Simulation:
    """Simulated silhouettes and where each comes from; fields as in :class:`index.store.PoseIndex`.

    Parameters
    ----------
    silhouette_store : Silhouettes
    entries : (E,) array of ENTRY_DTYPE
    skeletons : (S, 24, 3) float16 array
    skeleton_labels : (S,) array of SKELETON_DTYPE
    clips, subjects, actions : tuple of str
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
    workers: Workers | None = None,
    folder: Path | None = None,
) -> Simulation:
    """Render every pose on some bodies from some views, shard by shard.

    Parameters
    ----------
    poses : Poses
    avatars : sequence of Avatar
        Dealt out in turn, so that each gets its share of the poses.
    bodies : int
        Bodies per pose.
    views : int
        Views per pose and body.
    seed : int
        The same seed, poses and avatars give the same bytes, whoever draws.
    only_new : bool
        Whether poses laid down are left out where standing ones look the same: seen across.
    progress : bool
        Whether to draw a progress bar.
    workers : Workers, optional
        Who draws; by default threads of this process.
    folder : Path, optional
        Where the shards go, and stay; those that are there are not drawn again. By default a
        temporary folder.

    Returns
    -------
    Simulation
        Entries pose by pose, body by body, view by view.

    Raises
    ------
    ShardError
        If a shard cannot be drawn or read.
    """
    bodies = min(bodies, len(avatars))
    cast = _cast(len(poses) * bodies, len(avatars), seed)
    shards = _shards(poses, avatars, cast, views, seed, only_new)
    with nullcontext(folder) if folder else TemporaryDirectory() as where:
        files = _draw_all(shards, len(cast), avatars, Path(where), workers or Threads(), progress)
        store, entries, skeletons = _merge(files, len(cast) * views)
    rows = np.repeat(np.arange(len(poses)), bodies)
    labels = np.zeros(len(cast), SKELETON_DTYPE)
    labels["clip"], labels["frame"] = poses.clip[rows], poses.frame[rows]
    labels["subject"], labels["action"] = cast, poses.action[rows]
    labels["speed"] = poses.speeds()[rows]
    return Simulation(
        store, entries, skeletons, labels,
        tuple(clip.name for clip in poses.clips), tuple(a.name for a in avatars), poses.actions,
    )  # fmt: skip


def _cast(count: int, avatars: int, seed: int) -> NDArray[np.int64]:
    """Which avatar each body is ``(count,)``."""
    generator = np.random.default_rng(seed)
    rounds = [generator.permutation(avatars) for _ in range(-(-count // avatars))]
    return np.concatenate(rounds)[:count]


def _shards(
    poses: Poses,
    avatars: Sequence[Avatar],
    cast: NDArray[np.int64],
    views: int,
    seed: int,
    only_new: bool,
) -> Iterator[Shard]:
    bodies = len(cast) // len(poses)

    @cache
    def retargeting(clip: int, avatar: int) -> Retargeting:
        return retarget(poses.clips[clip], avatars[avatar])

    def transforms(number: int) -> NDArray[np.float64]:
        row, avatar = number // bodies, int(cast[number])
        rotations = poses.rotations(np.array([row]))
        retargeted = retargeting(int(poses.clip[row]), avatar)
        return np.asarray(pose_transforms(avatars[avatar], retargeted, rotations)[0])

    for start in range(0, len(poses), SHARD_POSES):
        rows = np.arange(start, min(start + SHARD_POSES, len(poses)))
        numbers = range(bodies * start, bodies * (rows[-1] + 1))
        yield Shard(
            first=numbers.start,
            avatar=cast[numbers.start : numbers.stop],
            transforms=np.stack([transforms(number) for number in numbers]),
            foreshortened=np.repeat(only_new & ~np.isnan(poses.lying_deg[rows]), bodies),
            views=views,
            seed=seed,
        )


def _draw_all(
    shards: Iterator[Shard],
    bodies: int,
    avatars: Sequence[Avatar],
    folder: Path,
    workers: Workers,
    progress: bool,
) -> list[Path]:
    """Have the shards drawn that are not there, and return the files of all, in order."""
    # Workers may run in other folders.
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    avatar_file, code = write_avatars(avatars, folder), code_version()
    there = {file.name for file in folder.iterdir()}
    files = []
    with tqdm(total=bodies, unit="body", desc="simulating", disable=not progress) as bar:

        def tasks() -> Iterator[Task]:
            for shard in shards:
                file = folder / name_of(shard, avatar_file, code)
                files.append(file)
                if file.name in there:
                    bar.update(len(shard))
                else:
                    yield Task(shard, avatar_file, file, code)

        for drawn in workers.map(perform, tasks()):
            bar.update(drawn)
    return files


def _merge(
    files: Sequence[Path], count: int
) -> tuple[Silhouettes, NDArray[np.void], NDArray[np.float16]]:
    """Read shards one by one; return their silhouettes, compressed, entries and skeletons."""
    in_each = len(read_drawn(files[0]).entries)
    sample = []
    wanted = sampled(count)
    for number in np.unique(wanted // in_each):
        rows = wanted[wanted // in_each == number] % in_each
        sample.append(read_drawn(files[number]).bits[rows])
    dictionary = np.concatenate(sample)
    stores, entries, skeletons = [], [], []
    for file in files:
        drawn = read_drawn(file)
        stores.append(Silhouettes.compress(drawn.bits, dictionary))
        entries.append(drawn.entries)
        skeletons.append(drawn.skeletons)
    return Silhouettes.joined(stores), np.concatenate(entries), np.concatenate(skeletons)
