"""The search among vectors by Milvus: as exact as in this process, sharded and replicated there.

A collection holds the vectors of an index and nothing else. Entries, skeletons and silhouettes stay
in the artefact, because re-ranking reads hundreds of them for each person. A collection never
changes once an alias names it; its description says which index it holds.

Imported only where an index is in Milvus: pymilvus takes 60 MB and a second.
"""

from __future__ import annotations

import json
import logging
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import grpc
import numpy as np
from numpy.typing import NDArray

from index.files import ArtefactError
from index.store import PoseIndex

with warnings.catch_warnings():
    # That pkg_resources, which it imports, is deprecated.
    warnings.simplefilter("ignore", UserWarning)
    from pymilvus import CollectionSchema, DataType, FieldSchema, MilvusException
    from pymilvus.client.grpc_handler import GrpcHandler

from index.search import FailureReason, Neighbours, UnavailableError

# It logs every failure, with a trace of its own; failures are told by our errors.
logging.getLogger("pymilvus").setLevel(logging.CRITICAL)

LARGEST_K = 16_384
"""Milvus finds no more neighbours of a query."""

PREFIX = "poses_"

_NUMBER, _VECTOR = "number", "vector"
_SEARCH = {"metric_type": "L2", "params": {}}
_STRONG, _EVENTUALLY = 0, 3
_ALIAS_NOT_FOUND, _COLLECTION_NOT_FOUND = 1600, 100

# By default gRPC waits up to two minutes before it tries again to connect, shares connections among
# channels, and refuses answers over 4 MB.
_CHANNEL = (
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.use_local_subchannel_pool", 1),
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
)

_CHECKED_VECTORS = 16
_SAME = 1e-4


@dataclass(frozen=True)
class Contents:
    """What a collection holds, as its description says.

    Parameters
    ----------
    name, version : str
        Of the index.
    entries, dimension : int
    """

    name: str
    version: str
    entries: int
    dimension: int

    @classmethod
    def of(cls, index: PoseIndex) -> Contents:
        """The contents of the collection of a loaded index."""
        return cls(index.name, index.version, len(index), index.descriptor.dimension)

    @property
    def collection(self) -> str:
        """Name of the collection: short, and another one for each version."""
        return PREFIX + self.version.removeprefix("sha256:")[:12]


@dataclass(frozen=True)
class Collection:
    """A collection in Milvus.

    Parameters
    ----------
    name : str
    contents : Contents
    created : float
        Seconds since 1970.
    aliases : tuple of str
    """

    name: str
    contents: Contents
    created: float
    aliases: tuple[str, ...]


class Milvus:
    """A connection to Milvus, made when it is needed and again after Milvus was away.

    Safe under several threads. Every method raises :class:`UnavailableError` where Milvus does not
    answer in time.

    Parameters
    ----------
    server : str
        Host and port.
    timeout_s : float
        For each call.
    """

    def __init__(self, server: str, timeout_s: float) -> None:
        self._server = server
        self._timeout_s = timeout_s
        self.reconnect()

    def reconnect(self) -> None:
        """Leave the connection to the calls that use it, and make another one for those to come.

        A server that is lost without a word leaves a connection behind that fails for minutes.
        """
        channel = grpc.insecure_channel(self._server, options=_CHANNEL)
        self._calls = GrpcHandler(address=self._server, channel=channel)

    def close(self) -> None:
        """Close the connection."""
        self._calls.close()

    def search(
        self, collection: str, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` nearest vectors in one call; see :meth:`Neighbours.search`."""
        if k > LARGEST_K:
            raise ValueError(f"expected k of at most {LARGEST_K}, got {k}")
        with self._errors():
            hits = self._calls.search(
                collection,
                queries,
                _VECTOR,
                _SEARCH,
                k,
                # The collection no longer changes.
                consistency_level=_EVENTUALLY,
                **self._once(),
            )
        if len(hits) != len(queries) or any(len(of_query.ids) != k for of_query in hits):
            raise UnavailableError(
                f"Milvus at {self._server} found fewer than {k} vectors in {collection}", "refused"
            )
        squared = np.array([of_query.distances for of_query in hits], np.float32)
        return squared, np.array([of_query.ids for of_query in hits], np.int64)

    def resolve(self, alias: str) -> str:
        """Return the name of the collection that an alias names now.

        Raises
        ------
        ArtefactError
            If there is no such alias.
        """
        with self._errors(absent=f"there is no alias {alias} in Milvus at {self._server}"):
            return str(self._calls.describe_alias(alias, **self._once())["collection_name"])

    def describe(self, collection: str) -> Collection:
        """Describe a collection.

        Raises
        ------
        ArtefactError
            If there is none of that name, or it holds no index.
        """
        with self._errors(absent=f"there is no collection {collection} at {self._server}"):
            found = self._calls.describe_collection(collection, **self._once())
        dimensions = [
            field["params"]["dim"] for field in found["fields"] if field["name"] == _VECTOR
        ]
        try:
            description = json.loads(found["description"])
            created = float(description.pop("created"))
            contents = Contents(**description)
        except (ValueError, KeyError, TypeError, AttributeError):
            raise ArtefactError(
                f"the collection {collection} at {self._server} holds no index: "
                "scripts/publish.py did not make it"
            ) from None
        if dimensions != [contents.dimension]:
            raise ArtefactError(
                f"expected vectors of {contents.dimension} values in {collection}, got {dimensions}"
            )
        return Collection(collection, contents, created, tuple(found["aliases"]))

    def collections(self) -> list[Collection]:
        """Describe all collections that hold an index, the newest first."""
        with self._errors():
            names = self._calls.list_collections(timeout=self._timeout_s)
        found = []
        for name in names:
            if name.startswith(PREFIX):
                try:
                    found.append(self.describe(name))
                except ArtefactError:
                    continue
        return sorted(found, key=lambda collection: -collection.created)

    def create(self, contents: Contents, *, shards: int, replicas: int) -> bool:
        """Make an empty collection, loaded, where there is none; return whether there was none."""
        name = contents.collection
        schema = CollectionSchema(
            [
                FieldSchema(_NUMBER, DataType.INT64, is_primary=True),
                FieldSchema(_VECTOR, DataType.FLOAT_VECTOR, dim=contents.dimension),
            ],
            description=json.dumps({**asdict(contents), "created": time.time()}),
        )
        with self._errors():
            absent = not self._calls.has_collection(name, **self._once())
            if absent:
                self._calls.create_collection(name, schema, shards_num=shards, **self._once())
            self._build_and_load(name, replicas)
        return absent

    def count(self, collection: str, start: int, stop: int) -> int:
        """Count the rows with numbers from ``start`` up to ``stop``."""
        with self._errors():
            rows = self._calls.query(
                collection,
                f"{start} <= {_NUMBER} < {stop}",
                ["count(*)"],
                consistency_level=_STRONG,
                **self._once(),
            )
        return int(rows[0]["count(*)"])

    def write(
        self, collection: str, start: int, vectors: NDArray[np.float32], *, replace: bool
    ) -> None:
        """Write vectors ``(B, D)`` as the rows from ``start`` on.

        ``replace`` where there may be rows of these numbers already, which takes longer.
        """
        columns: list[dict[str, Any]] = [
            {
                "name": _NUMBER,
                "type": DataType.INT64,
                "values": list(range(start, start + len(vectors))),
            },
            {"name": _VECTOR, "type": DataType.FLOAT_VECTOR, "values": vectors.tolist()},
        ]
        with self._errors():
            write = self._calls.upsert if replace else self._calls.batch_insert
            write(collection, columns, **self._once())

    def finish(self, collection: str, *, replicas: int) -> None:
        """Have everything written stored, indexed and loaded anew; it is not searched meanwhile.

        What was loaded while it was written is searched several times more slowly.
        """
        with self._errors():
            self._calls.flush([collection], timeout=self._timeout_s)
            self._calls.release_collection(collection, timeout=self._timeout_s)
            self._build_and_load(collection, replicas)

    def name(self, alias: str, collection: str) -> None:
        """Have an alias name a collection from now on, in one step."""
        try:
            self.resolve(alias)
        except ArtefactError:
            with self._errors():
                self._calls.create_alias(collection, alias, **self._once())
        else:
            with self._errors():
                self._calls.alter_alias(collection, alias, **self._once())

    def drop(self, collection: str) -> None:
        """Remove a collection."""
        with self._errors():
            self._calls.drop_collection(collection, timeout=self._timeout_s)

    def _build_and_load(self, collection: str, replicas: int) -> None:
        """Index and load a collection, and wait for both; nothing happens where they are done."""
        self._calls.create_index(
            collection, _VECTOR, {"index_type": "FLAT", **_SEARCH}, timeout=self._timeout_s
        )
        self._calls.load_collection(collection, replicas, timeout=self._timeout_s)

    def _once(self) -> dict[str, Any]:
        """Deadline of a call; pymilvus would try again up to 75 times."""
        return {"timeout": float(self._timeout_s), "retry_times": 0}

    @contextmanager
    def _errors(self, absent: str = "") -> Iterator[None]:
        """Turn errors of pymilvus into ours.

        ``absent`` is the sentence where what the call names does not exist.
        """
        try:
            yield
        except (MilvusException, grpc.RpcError) as error:
            code = _code(error)
            if absent and code in (_ALIAS_NOT_FOUND, _COLLECTION_NOT_FOUND):
                raise ArtefactError(absent) from error
            sentence, reason = self._failure(code, error)
            raise UnavailableError(f"Milvus at {self._server} {sentence}", reason) from error

    def _failure(self, code: object, error: Exception) -> tuple[str, FailureReason]:
        if code is grpc.StatusCode.DEADLINE_EXCEEDED:
            return f"did not answer in {self._timeout_s:g} s", "deadline"
        if code is grpc.StatusCode.UNAVAILABLE:
            return "cannot be reached", "unreachable"
        message = error.message if isinstance(error, MilvusException) else str(code)
        return f"answered with an error: {message.removeprefix(_NOT_RETRIED)}", "refused"


_NOT_RETRIED = "Retry run out of 0 retry times, message="


def _code(error: Any) -> object:
    """Code of an error of gRPC or of Milvus."""
    code = error.code
    # pymilvus hands on the method of gRPC's error where it has given up to try again.
    return code() if callable(code) else code


class MilvusNeighbours:
    """The vectors of a collection, searched by Milvus; see :class:`Neighbours`.

    Parameters
    ----------
    milvus : Milvus
    collection : str
        The name itself, no alias: what an alias names may change between two searches.
    entries : int
    """

    def __init__(self, milvus: Milvus, collection: str, entries: int) -> None:
        self._milvus = milvus
        self._collection = collection
        self._entries = entries

    def __len__(self) -> int:
        return self._entries

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query; see :meth:`Neighbours.search`."""
        return self._milvus.search(self._collection, queries, k)


def check_vectors(index: PoseIndex, neighbours: Neighbours) -> None:
    """Make sure that a search finds vectors of an index where they are.

    Raises
    ------
    ArtefactError
        If it does not: it searches other vectors.
    """
    numbers = np.linspace(0, len(index) - 1, min(len(index), _CHECKED_VECTORS)).astype(np.int64)
    vectors = index.vectors[numbers].astype(np.float32)
    squared, found = neighbours.search(vectors, 1)
    found = found[:, 0]
    known = found[(found >= 0) & (found < len(index))]
    # Another entry may have the same vector.
    if len(known) < len(found) or not (
        np.all(squared < _SAME) and np.array_equal(index.vectors[known], index.vectors[numbers])
    ):
        raise ArtefactError(
            f"the collection searched for the index {index.version} holds other vectors"
        )


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
