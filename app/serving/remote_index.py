"""An index whose vectors are searched by Milvus, and all else of which is in an artefact."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from app.serving.breaker import CircuitBreaker, GuardedNeighbours
from index.artefact import find_artefact, load_index
from index.milvus_address import MilvusAddress
from index.store import PoseIndex


class MissingPackageError(ImportError):
    """The package that speaks to Milvus is not installed."""


def check_milvus_package() -> None:
    """Raise :class:`MissingPackageError` where the extra ``milvus`` is not installed."""
    if not (importlib.util.find_spec("pymilvus") and importlib.util.find_spec("pkg_resources")):
        raise MissingPackageError(
            "POSE_INDEX: expected the packages of the extra milvus for an index in Milvus, "
            "which pip install 'silhouette-pose[milvus]' installs"
        )


class RemoteIndex:
    """Loads the index that an alias names, and tells when it names another one.

    Its methods wait for Milvus, so they are called in a thread of their own.

    Parameters
    ----------
    address : MilvusAddress
    artefacts : Path
        The artefact, or a folder of several: the one whose version is the collection's is taken.
    timeout_s : float
        For a search.
    breaker : CircuitBreaker
    """

    def __init__(
        self, address: MilvusAddress, artefacts: Path, timeout_s: float, breaker: CircuitBreaker
    ) -> None:
        from index.milvus import Milvus

        self._milvus = Milvus(address.server, timeout_s)
        self._alias = address.alias
        self._artefacts = artefacts
        self._breaker = breaker
        self._collection = ""

    def load(self) -> PoseIndex | None:
        """Load the index that the alias names now; None if that is the one loaded last.

        Raises
        ------
        ArtefactError
            If nothing is published under the alias, if there is no artefact of that version, or if
            the collection holds other vectors.
        UnavailableError
            If Milvus does not answer.
        """
        from index.milvus import MilvusNeighbours, check_vectors

        name = self._milvus.resolve(self._alias)
        if name == self._collection:
            return None
        contents = self._milvus.describe(name).contents
        path = find_artefact(self._artefacts, contents.version)
        neighbours = MilvusNeighbours(self._milvus, name, contents.entries)
        index = load_index(path, GuardedNeighbours(neighbours, self._breaker))
        check_vectors(index, neighbours)
        self._collection = name
        return index

    def reconnect(self) -> None:
        """Connect anew, where Milvus was away."""
        self._milvus.reconnect()
