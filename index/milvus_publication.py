"""Loads an index into a collection of Milvus, and then has an alias name it.

Killed at any point, it goes on from there when run again; the alias never names a collection that
is not complete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from index.milvus import Collection, Contents, Milvus, MilvusNeighbours, check_vectors
from index.store import PoseIndex
from index.verified_files import ArtefactError

BATCH = 10_000
"""Rows in a call: 2 MB."""

Progress = Callable[[Sequence[int]], Iterable[int]]


def publish(
    milvus: Milvus,
    index: PoseIndex,
    alias: str,
    *,
    shards: int = 1,
    replicas: int = 1,
    batch: int = BATCH,
    progress: Progress = lambda starts: starts,
) -> Collection:
    """Load an index and switch the alias to it.

    Parameters
    ----------
    milvus : Milvus
    index : PoseIndex
        Loaded from an artefact.
    alias : str
        What services name.
    shards, replicas : int
        Of a new collection.
    batch : int
        Rows in a call.
    progress : callable
        Wraps the numbers of the first rows of all batches.

    Raises
    ------
    ArtefactError
        If a collection of that name holds something else.
    UnavailableError
        If Milvus does not answer; run it again.
    """
    contents = Contents.of(index)
    name = contents.collection
    is_new = milvus.create(contents, shards=shards, replicas=replicas)
    collection = milvus.describe(name)
    if collection.contents != contents:
        raise ArtefactError(f"expected {contents} in the collection {name}, {collection.contents}")
    written = False
    for start in progress(range(0, len(index), batch)):
        stop = min(start + batch, len(index))
        if is_new or milvus.count(name, start, stop) != stop - start:
            vectors = index.vectors[start:stop].astype(np.float32)
            milvus.write(name, start, vectors, replace=not is_new)
            written = True
    if written:  # Else it may be searched by services.
        milvus.finish(name, replicas=replicas)
    count = milvus.count(name, 0, len(index))
    if count != len(index):
        milvus.drop(name)
        raise ArtefactError(f"expected {len(index)} rows in {name}, got {count}; it was removed")
    check_vectors(index, MilvusNeighbours(milvus, name, len(index)))
    milvus.name(alias, name)
    return milvus.describe(name)


def remove_older(milvus: Milvus, current: Collection, keep: int) -> list[str]:
    """Remove all but the newest collections that no alias names, and return what was removed.

    Parameters
    ----------
    milvus : Milvus
    current : Collection
        The one that was published last; stays.
    keep : int
        Others that stay, for services that have not moved over yet and to go back to.
    """
    others = [
        collection
        for collection in milvus.collections()
        if collection.name != current.name and not collection.aliases
    ]
    removed = [collection.name for collection in others[keep:]]
    for name in removed:
        milvus.drop(name)
    return removed
