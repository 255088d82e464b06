"""The vectors of an index in Milvus: sharded, replicated, and searched exactly, as in this process.

A collection holds the vectors of an index and nothing else. Entries, skeletons and silhouettes stay
in the artefact, because re-ranking reads hundreds of them for each person. A collection never
changes once an alias names it; its description says which index it holds.

This module is imported only if an index is in Milvus: pymilvus takes 60 MB and a second.
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
    # pymilvus imports pkg_resources, which is deprecated.
    warnings.simplefilter("ignore", UserWarning)
    from pymilvus import CollectionSchema, DataType, FieldSchema, MilvusClient, MilvusException
    from pymilvus.client.grpc_handler import GrpcHandler

from index.search import FailureReason, Neighbours, UnavailableError

# pymilvus logs every failure with its traceback; here failures are errors.
logging.getLogger("pymilvus").setLevel(logging.CRITICAL)

LARGEST_K = 16_384
"""Milvus finds at most this many neighbours of a query."""

PREFIX = "poses_"

_NUMBER, _VECTOR = "number", "vector"
_SEARCH = {"metric_type": "L2", "params": {}}
_STRONG, _EVENTUALLY = 0, 3
_ALIAS_NOT_FOUND, _COLLECTION_NOT_FOUND = 1600, 100

# By default gRPC waits up to two minutes before it reconnects, shares connections among channels,
# and refuses answers over 4 MB.
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


class _Client(MilvusClient):  # type: ignore[misc]
    """MilvusClient that connects when it is first used.

    The public one of pymilvus 2.4 waits for the server in its constructor, takes no options of
    gRPC, retries each insert up to 75 times and cannot flush. What is private to pymilvus is used
    in this class only.
    """

    def __init__(self, server: str) -> None:
        channel = grpc.insecure_channel(server, options=_CHANNEL)
        self._handler = GrpcHandler(address=server, channel=channel)

    def _get_connection(self) -> Any:
        return self._handler

    def insert(self, collection_name: str, data: list[dict[str, Any]], **once: Any) -> None:
        self._handler.insert_rows(collection_name, data, **once)

    def flush(self, collection_name: str, timeout: float) -> None:
        self._handler.flush([collection_name], timeout=timeout)

    def close(self) -> None:
        self._handler.close()


class Milvus:
    """A connection to Milvus, made when it is needed and again after an outage.

    Safe under several threads. Every method raises :class:`UnavailableError` if Milvus does not
    answer in time.

    Parameters
    ----------
    server : str
        Host and port.
    timeout_s : float
        Longest time for each call.
    """

    def __init__(self, server: str, timeout_s: float) -> None:
        self._server = server
        self._timeout_s = timeout_s
        self.reconnect()

    def reconnect(self) -> None:
        """Use a new connection for future calls; calls under way keep the old one.

        A server that vanishes leaves a connection behind that fails for minutes.
        """
        self._client = _Client(self._server)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def search(
        self, collection: str, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` nearest vectors in one call; see :meth:`Neighbours.search`."""
        if k > LARGEST_K:
            raise ValueError(f"expected k of at most {LARGEST_K}, got {k}")
        with self._errors():
            found = self._client.search(
                collection,
                queries,
                limit=k,
                anns_field=_VECTOR,
                search_params=_SEARCH,
                # The collection no longer changes.
                consistency_level=_EVENTUALLY,
                **self._once(),
            )
        if len(found) != len(queries) or any(len(hits) != k for hits in found):
            raise UnavailableError(
                f"Milvus at {self._server} found fewer than {k} vectors in {collection}", "refused"
            )
        squared = np.array([[hit["distance"] for hit in hits] for hits in found], np.float32)
        return squared, np.array([list(map(_number, hits)) for hits in found], np.int64)

    def resolve(self, alias: str) -> str:
        """Return the name of the collection that an alias names now.

        Raises
        ------
        ArtefactError
            If there is no such alias.
        """
        with self._errors(absent=f"there is no alias {alias} in Milvus at {self._server}"):
            return str(self._client.describe_alias(alias, **self._once())["collection_name"])

    def describe(self, collection: str) -> Collection:
        """Describe a collection.

        Raises
        ------
        ArtefactError
            If there is no collection of that name, or it holds no index.
        """
        with self._errors(absent=f"there is no collection {collection} at {self._server}"):
            found = self._client.describe_collection(collection, **self._once())
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
            names = self._client.list_collections(timeout=self._timeout_s)
        found = []
        for name in names:
            if name.startswith(PREFIX):
                try:
                    found.append(self.describe(name))
                except ArtefactError:
                    continue
        return sorted(found, key=lambda collection: -collection.created)

    def create(self, contents: Contents, *, shards: int, replicas: int) -> bool:
        """Make and load an empty collection unless it exists; return whether it is new."""
        name = contents.collection
        schema = CollectionSchema(
            [
                FieldSchema(_NUMBER, DataType.INT64, is_primary=True),
                FieldSchema(_VECTOR, DataType.FLOAT_VECTOR, dim=contents.dimension),
            ],
            description=json.dumps({**asdict(contents), "created": time.time()}),
        )
        with self._errors():
            is_new = not self._client.has_collection(name, **self._once())
            if is_new:
                self._client.create_collection(
                    name, schema=schema, num_shards=shards, **self._once()
                )
            self._build_and_load(name, replicas)
        return is_new

    def count(self, collection: str, start: int, stop: int) -> int:
        """Count the rows with numbers from ``start`` up to ``stop``."""
        with self._errors():
            rows = self._client.query(
                collection,
                f"{start} <= {_NUMBER} < {stop}",
                output_fields=["count(*)"],
                consistency_level=_STRONG,
                **self._once(),
            )
        return int(rows[0]["count(*)"])

    def write(
        self, collection: str, start: int, vectors: NDArray[np.float32], *, replace: bool
    ) -> None:
        """Write vectors ``(B, D)`` as the rows from ``start`` on.

        ``replace`` rows of these numbers that may exist already, which takes longer.
        """
        rows = [
            {_NUMBER: number, _VECTOR: vector}
            for number, vector in enumerate(vectors.tolist(), start=start)
        ]
        with self._errors():
            write = self._client.upsert if replace else self._client.insert
            write(collection, rows, **self._once())

    def finish(self, collection: str, *, replicas: int) -> None:
        """Store, index and reload everything written; the collection is not searched meanwhile.

        Vectors loaded while they are written are searched several times more slowly.
        """
        with self._errors():
            self._client.flush(collection, timeout=self._timeout_s)
            self._client.release_collection(collection, timeout=self._timeout_s)
            self._build_and_load(collection, replicas)

    def name(self, alias: str, collection: str) -> None:
        """Have an alias name a collection from now on, in one step."""
        try:
            self.resolve(alias)
            change = self._client.alter_alias
        except ArtefactError:
            change = self._client.create_alias
        with self._errors():
            change(collection, alias, **self._once())

    def drop(self, collection: str) -> None:
        """Remove a collection."""
        with self._errors():
            self._client.drop_collection(collection, timeout=self._timeout_s)

    def _build_and_load(self, collection: str, replicas: int) -> None:
        """Index and load a collection, and wait for both; does nothing if they are done."""
        index = self._client.prepare_index_params(_VECTOR, index_type="FLAT", **_SEARCH)
        self._client.create_index(collection, index, timeout=self._timeout_s)
        self._client.load_collection(collection, replica_number=replicas, timeout=self._timeout_s)

    def _once(self) -> dict[str, Any]:
        """Deadline of a call; pymilvus would try again up to 75 times."""
        return {"timeout": float(self._timeout_s), "retry_times": 0}

    @contextmanager
    def _errors(self, absent: str = "") -> Iterator[None]:
        """Turn errors of pymilvus into ours.

        ``absent`` is the sentence to report if the alias or collection does not exist.
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


def _number(hit: dict[str, Any]) -> int:
    """Row that a search found; servers before 2.4 do not name the primary key."""
    return int(hit[_NUMBER] if _NUMBER in hit else hit["id"])


_NOT_RETRIED = "Retry run out of 0 retry times, message="


def _code(error: Any) -> object:
    """Code of an error of gRPC or of Milvus."""
    code = error.code
    # After its last retry, pymilvus sets the code to a method of gRPC's error.
    return code() if callable(code) else code


class MilvusNeighbours:
    """The vectors of a collection, searched by Milvus; see :class:`Neighbours`.

    Parameters
    ----------
    milvus : Milvus
    collection : str
        Its name rather than an alias, which may name different collections in two searches.
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
    """Check that a search is among the vectors of an index.

    Raises
    ------
    ArtefactError
        If the search is among other vectors.
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
"""Rows written in one call: 2 MB."""

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
        Name by which services find the collection.
    shards, replicas : int
        Shards of a new collection, and its replicas in memory.
    batch : int
        Rows written in one call.
    progress : callable
        Wraps the iterable of the batches' first rows, to show progress.

    Raises
    ------
    ArtefactError
        If a collection of that name holds something else.
    UnavailableError
        If Milvus does not answer. Publishing again continues.
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
    if written:  # Otherwise services may be searching it.
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
        The collection published last, which stays.
    keep : int
        Number of others that stay, for services that have not switched yet and for rollbacks.
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
