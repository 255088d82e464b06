"""Searches for the vectors nearest to a query, by Euclidean distance."""

from __future__ import annotations

import os
from typing import Any, Literal, Protocol

# With several OpenMP threads FAISS answers a single query more slowly and less exactly.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import faiss
import numpy as np
from numpy.typing import NDArray

STEPS = np.float32(8)
"""Values of descriptors are multiples of 1/8, far below what noise does to them: files compress to
a quarter, and a byte holds each value exactly."""

_LARGEST_STEP = 128


FailureReason = Literal["deadline", "unreachable", "refused"]
"""Why a search by another server failed: too slow, not there, or answered with an error."""


class UnavailableError(Exception):
    """A search by another server failed, though it may succeed later.

    Parameters
    ----------
    message : str
        One sentence for the operator.
    reason : FailureReason
    """

    def __init__(self, message: str, reason: FailureReason) -> None:
        super().__init__(message)
        self.reason: FailureReason = reason


class Neighbours(Protocol):
    """A search for the nearest of a fixed set of vectors; safe under several threads."""

    def __len__(self) -> int:
        """Count the vectors."""

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query.

        Parameters
        ----------
        queries : (Q, D) float32 array
        k : int
            From 1 to the number of vectors.

        Returns
        -------
        squared : (Q, k) float32 array
            Squared Euclidean distances, ascending.
        numbers : (Q, k) int64 array

        Raises
        ------
        UnavailableError
            If the search is done by a server that does not answer.
        """


class ExactNeighbours:
    """Compares each query with all vectors, in this process.

    Parameters
    ----------
    vectors : (E, D) float array
    """

    def __init__(self, vectors: NDArray[np.floating]) -> None:
        steps = np.asarray(vectors, np.float32) * STEPS
        whole = np.array_equal(steps, np.rint(steps)) and np.abs(steps).max() < _LARGEST_STEP
        self._steps = STEPS if whole else np.float32(1)
        self._faiss = _in_bytes(steps) if whole else _flat(np.asarray(vectors, np.float32))

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query; see :meth:`Neighbours.search`."""
        scaled = np.ascontiguousarray(queries * self._steps, np.float32)
        squared, numbers = self._faiss.search(scaled, k)
        return squared / self._steps**2, numbers


def _flat(vectors: NDArray[np.float32]) -> Any:
    """An exhaustive search of any vectors ``(E, D)``."""
    flat = faiss.IndexFlatL2(vectors.shape[1])
    flat.add(vectors)
    return flat


def _in_bytes(steps: NDArray[np.float32]) -> Any:
    """An exhaustive search of whole numbers below 128: as exact, in half the time."""
    kind = faiss.ScalarQuantizer.QT_8bit_direct_signed
    exhaustive = faiss.IndexScalarQuantizer(steps.shape[1], kind, faiss.METRIC_L2)
    exhaustive.train(steps[:1])
    exhaustive.add(steps)
    return exhaustive
