"""The vectors of an index in Milvus, which searches them exactly, as this process would.

A collection holds the vectors of one version of an index; its name has the version. Everything else
stays in the artefact, because re-ranking reads hundreds of skeletons and silhouettes for each
person. An alias names the collection to search; :mod:`scripts.publish` moves the alias, only to a
complete collection.

Only code that needs Milvus imports this module: pymilvus takes a second and 60 MB.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import grpc
import numpy as np
from numpy.typing import NDArray
from pymilvus import MilvusClient, MilvusException

from index.artefact import ArtefactError, find_artefact, load_index
from index.search import SearchUnavailableError
from index.store import PoseIndex

# pymilvus logs every failure with its traceback; here failures are errors.
logging.getLogger("pymilvus").setLevel(logging.CRITICAL)

ALIAS = "poses"
"""Names the collection to search. Services that search other indexes use databases of their own."""

NAME_PREFIX = "poses_"
ROW, VECTOR = "number", "vector"
METRIC = {"metric_type": "L2"}

_TIMEOUT_S = 2.0  # Longest time of a call.


@contextmanager
def milvus_errors() -> Iterator[None]:
    """Raise :class:`SearchUnavailableError` for all errors of Milvus and gRPC."""
    try:
        yield
    except MilvusException as error:
        raise SearchUnavailableError(f"Milvus failed: {error.message}") from error
    except grpc.RpcError as error:
        raise SearchUnavailableError(f"Milvus failed: {error.code().name}") from error


class MilvusNeighbours:
    """The vectors of a collection; see :class:`index.search.Neighbours`.

    Parameters
    ----------
    collection : str
        Its own name: an alias could name different collections in two searches.
    """

    def __init__(self, client: MilvusClient, collection: str) -> None:
        self._client = client
        self._collection = collection
        count = {"output_fields": ["count(*)"], "consistency_level": "Strong"}
        with milvus_errors():
            (row,) = client.query(collection, timeout=_TIMEOUT_S, **count)
        self._entries = int(row["count(*)"])

    def __len__(self) -> int:
        return self._entries

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query; see :meth:`Neighbours.search`."""
        with milvus_errors():
            found = self._client.search(
                self._collection,
                queries,
                limit=k,
                anns_field=VECTOR,
                search_params=METRIC,
                output_fields=[ROW],
                consistency_level="Eventually",  # The collection no longer changes.
                timeout=_TIMEOUT_S,
            )
        if len(found) != len(queries) or any(len(hits.ids) != k for hits in found):
            raise SearchUnavailableError(
                f"Milvus found fewer than {k} vectors in {self._collection}"
            )
        squared = np.array([hits.distances for hits in found], np.float32)
        return squared, np.array([hits.ids for hits in found], np.int64)

    def check(self, index: PoseIndex) -> None:
        """Raise :class:`ArtefactError` if these are not the vectors of an index."""
        ends = index.vectors[[0, -1]]
        # Squared distances of equal vectors stay below.
        if len(self) != len(index) or self.search(ends, 1)[0].max() > 1e-4:
            raise ArtefactError(f"the collection {self._collection} holds other vectors")


def load_published(uri: str, artefacts: Path, known: str = "") -> PoseIndex | None:
    """Load the index that the alias names, to be searched in Milvus; None if it is ``known``.

    ``artefacts`` is the artefact, or a folder of several; ``known`` the version loaded already.

    Raises
    ------
    ArtefactError, SearchUnavailableError
        If the collection or its artefact cannot be used; if Milvus does not answer, or nothing is
        published.
    """
    with milvus_errors():
        client = MilvusClient(uri, timeout=_TIMEOUT_S)
        name = str(client.describe_alias(ALIAS, timeout=_TIMEOUT_S)["collection_name"])
    version = f"sha256:{name.removeprefix(NAME_PREFIX)}"
    if version == known:
        return None
    path = find_artefact(artefacts, version)
    neighbours = MilvusNeighbours(client, name)
    index = load_index(path, neighbours)
    neighbours.check(index)
    return index
