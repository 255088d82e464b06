"""An index whose vectors are in Milvus, and the circuit breaker around its searches.

All but the vectors is read from an artefact. A server that does not answer is not asked again by
every request.
"""

from __future__ import annotations

import importlib.util
import logging
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from index.artefact import find_artefact, load_index
from index.milvus_address import MilvusAddress
from index.search import FailureReason, Neighbours, UnavailableError
from index.store import PoseIndex

log = logging.getLogger("app")

OPEN_AFTER = 3
"""Failures in a row after which the breaker opens."""


class CircuitBreaker:
    """Open after several failures in a row, closed again by the first success.

    Parameters
    ----------
    on_failure : callable
        Called with the reason of every failure.
    open_after : int
        Failures in a row.
    """

    def __init__(
        self,
        on_failure: Callable[[FailureReason], object] = lambda reason: None,
        open_after: int = OPEN_AFTER,
    ) -> None:
        self._on_failure = on_failure
        self._open_after = open_after
        self._failures = 0
        self._last: UnavailableError | None = None
        self._lock = threading.Lock()

    @property
    def is_open(self) -> bool:
        """Whether requests are refused at once."""
        return self._failures >= self._open_after

    def check(self) -> None:
        """Raise the last failure if it is open."""
        last = self._last
        if self.is_open and last is not None:
            raise UnavailableError(str(last), last.reason)

    def failed(self, error: UnavailableError) -> None:
        """Count a failure."""
        self._on_failure(error.reason)
        with self._lock:
            self._failures += 1
            # Without its traceback, which would keep the frame that was being searched for.
            self._last = UnavailableError(str(error), error.reason)
            opens = self._failures == self._open_after
        if opens:
            log.error("searches are refused until one succeeds: %s", error)

    def succeeded(self) -> None:
        """Note a success."""
        if not self._failures:
            return
        with self._lock:
            closes, self._failures, self._last = self.is_open, 0, None
        if closes:
            log.info("searches succeed again")


class GuardedNeighbours:
    """A search behind a circuit breaker; see :class:`index.search.Neighbours`.

    Parameters
    ----------
    neighbours : Neighbours
    breaker : CircuitBreaker
    """

    def __init__(self, neighbours: Neighbours, breaker: CircuitBreaker) -> None:
        self._neighbours = neighbours
        self._breaker = breaker

    def __len__(self) -> int:
        return len(self._neighbours)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Search, unless the breaker is open."""
        self._breaker.check()
        return self.search_anyway(queries, k)

    def search_anyway(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Search, and have the breaker note the outcome."""
        try:
            found = self._neighbours.search(queries, k)
        except UnavailableError as error:
            self._breaker.failed(error)
            raise
        self._breaker.succeeded()
        return found


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
