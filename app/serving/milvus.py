"""An index whose vectors are in Milvus; everything else is read from an artefact."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from index.artefact import find_artefact, load_index
from index.milvus_address import MilvusAddress
from index.search import FailureReason, Neighbours, UnavailableError
from index.store import PoseIndex

log = logging.getLogger("app")

SearchObserver = Callable[[FailureReason | None], object]
"""Takes the reason of each failed search, and None for each that succeeded."""


class ObservedNeighbours:
    """A search whose outcomes are reported; see :class:`index.search.Neighbours`.

    Every search asks Milvus again. Its timeout bounds how long a search takes, and the queue bounds
    how many frames wait meanwhile.

    Parameters
    ----------
    neighbours : Neighbours
        The search itself.
    observe : callable
        Called after each search.
    """

    def __init__(self, neighbours: Neighbours, observe: SearchObserver) -> None:
        self._neighbours = neighbours
        self._observe = observe
        self._failing = False

    def __len__(self) -> int:
        return len(self._neighbours)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Search and report the outcome; log where failures begin and end."""
        try:
            found = self._neighbours.search(queries, k)
        except UnavailableError as error:
            self._observe(error.reason)
            if not self._failing:
                log.error("searches fail: %s", error)
            self._failing = True
            raise
        self._observe(None)
        if self._failing:
            log.info("searches succeed again")
        self._failing = False
        return found


class MissingPackageError(ImportError):
    """The package pymilvus is not installed."""


def check_milvus_package() -> None:
    """Raise :class:`MissingPackageError` if the extra ``milvus`` is not installed."""
    if not (importlib.util.find_spec("pymilvus") and importlib.util.find_spec("pkg_resources")):
        raise MissingPackageError(
            "POSE_INDEX: expected the packages of the extra milvus for an index in Milvus, "
            "which pip install 'silhouette-pose[milvus]' installs"
        )


class RemoteIndex:
    """Loads the index that an alias names, and notices when it names another one.

    :meth:`load` waits for Milvus, so it is called in a separate thread.

    Parameters
    ----------
    address : MilvusAddress
    artefacts : Path
        The artefact, or a folder of several; the one with the collection's version is loaded.
    timeout_s : float
        Longest time for a call.
    observe : callable
        Called after each search in the loaded indexes.
    """

    def __init__(
        self, address: MilvusAddress, artefacts: Path, timeout_s: float, observe: SearchObserver
    ) -> None:
        from index.milvus import Milvus

        self._milvus = Milvus(address.server, timeout_s)
        self._alias = address.alias
        self._artefacts = artefacts
        self._observe = observe
        self._collection = ""

    def load(self) -> PoseIndex | None:
        """Load the index that the alias names now; None if it was loaded last.

        Raises
        ------
        ArtefactError
            If nothing is published under the alias, if there is no artefact of that version, or if
            the collection holds other vectors.
        UnavailableError
            If Milvus does not answer. The next call uses a new connection: a server that vanishes
            leaves one behind that fails for minutes.
        """
        from index.milvus import MilvusNeighbours, check_vectors

        try:
            name = self._milvus.resolve(self._alias)
            if name == self._collection:
                return None
            contents = self._milvus.describe(name).contents
            path = find_artefact(self._artefacts, contents.version)
            neighbours = MilvusNeighbours(self._milvus, name, contents.entries)
            index = load_index(path, ObservedNeighbours(neighbours, self._observe))
            check_vectors(index, neighbours)
        except UnavailableError:
            self._milvus.reconnect()
            raise
        self._collection = name
        return index
