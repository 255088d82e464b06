"""Poses x bodies x views to silhouettes with their skeletons."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from tempfile import TemporaryFile
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import Descriptor
from index.skeleton import POINTS
from index.store import ENTRY_DTYPE, PACKED_BYTES, SKELETON_DTYPE, Silhouettes
from scripts.index.body import Avatar, Retargeting, pose_transforms, retarget
from scripts.index.poses import Poses
from scripts.index.views import PosedBodies, render_bodies
from scripts.index.writer import compress

BLOCK = 4096
"""Silhouettes unpacked and described at a time."""

BATCH = 100
"""Bodies of one avatar rendered in one task: a second or two of work."""

MAX_PENDING = 128
"""Tasks handed out at a time: enough for the cores of a large cluster, 40 MB of transforms."""


_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Simulation:
    """Simulated silhouettes and their origin; fields as in :class:`index.store.PoseIndex`."""

    silhouette_store: Silhouettes
    entries: NDArray[np.void]  # (E,)
    skeletons: NDArray[np.float16]  # (S, 24, 3)
    skeleton_labels: NDArray[np.void]  # (S,)
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
    executor: Executor | None = None,
) -> Simulation:
    """Render every pose on some bodies from some views: entries pose by pose, body by body.

    Avatars are dealt out in turn, so that each gets its share of the poses. The same seed, poses
    and avatars give the same bytes, whatever the executor, by default threads of this process. With
    ``only_new``, poses laid down are seen along the trunk only: seen across, they look like
    standing ones.
    """
    bodies = min(bodies, len(avatars))
    assigned = assign_avatars(len(poses) * bodies, len(avatars), seed)
    batches = [
        (avatar, own[start : start + BATCH])
        for position, avatar in enumerate(avatars)
        for own in [np.flatnonzero(assigned == position)]
        for start in range(0, len(own), BATCH)
    ]
    tasks = (
        (avatar, _posed(poses, numbers, bodies, avatar, only_new), views, seed)
        for avatar, numbers in batches
    )
    entries = np.empty((len(assigned), views), ENTRY_DTYPE)
    skeletons = np.empty((len(assigned), POINTS, 3), np.float16)
    with (
        TemporaryFile() as file,
        nullcontext(executor) if executor else ThreadPoolExecutor(os.cpu_count()) as pool,
        tqdm(total=len(assigned), unit="body", desc="simulating", disable=None) as bar,
    ):
        # In a file, since a large index has no room in memory until it is compressed.
        bits = np.memmap(file, np.uint8, shape=(len(assigned), views, PACKED_BYTES))
        rendered = bounded_map(pool, render_bodies, tasks)
        for (_, numbers), found in zip(batches, rendered, strict=True):
            bits[numbers], entries[numbers], skeletons[numbers] = found
            bar.update(len(numbers))
        store = compress(bits.reshape(-1, PACKED_BYTES))
    rows = np.repeat(np.arange(len(poses)), bodies)
    labels = np.zeros(len(assigned), SKELETON_DTYPE)
    labels["clip"], labels["frame"] = poses.clip[rows], poses.frame[rows]
    labels["subject"], labels["action"] = assigned, poses.action[rows]
    labels["speed"] = poses.speeds()[rows]
    return Simulation(
        store, entries.ravel(), skeletons, labels,
        tuple(clip.name for clip in poses.clips), tuple(a.name for a in avatars), poses.actions,
    )  # fmt: skip


def assign_avatars(count: int, avatars: int, seed: int) -> NDArray[np.int64]:
    """Position of the avatar of each of ``count`` bodies; each avatar is as frequent as others."""
    generator = np.random.default_rng(seed)
    rounds = [generator.permutation(avatars) for _ in range(-(-count // avatars))]
    return np.concatenate(rounds)[:count]


def _posed(
    poses: Poses, numbers: NDArray[np.int64], bodies: int, avatar: Avatar, only_new: bool
) -> PosedBodies:
    """Pose an avatar for the bodies of these numbers; each pose has ``bodies``."""

    @cache
    def retargeting(clip: int) -> Retargeting:
        return retarget(poses.clips[clip], avatar)

    rows = numbers // bodies
    transforms = [
        pose_transforms(avatar, retargeting(int(poses.clip[row])), poses.rotations(row[None]))[0]
        for row in rows
    ]
    return PosedBodies(numbers, np.stack(transforms), only_new & ~np.isnan(poses.lying_deg[rows]))


def bounded_map(
    executor: Executor,
    function: Callable[..., _Result],
    tasks: Iterable[tuple[Any, ...]],
    max_pending: int = MAX_PENDING,
) -> Iterator[_Result]:
    """Call a function with each task's arguments; results in order, ``max_pending`` at a time.

    :meth:`concurrent.futures.Executor.map` would take all tasks at once.
    """
    pending: deque[Future[_Result]] = deque()
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
