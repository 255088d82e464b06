"""Searches for the vectors nearest to a query, by Euclidean distance."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any, Literal, Protocol

# With several OpenMP threads FAISS answers a single query more slowly and less exactly.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import faiss
import numpy as np
from numpy.typing import NDArray

STEPS = np.float32(8)
"""Values of descriptors are multiples of 1/8, far below what noise does to them: files compress to
a quarter, and a byte holds each value exactly."""

BYTES = faiss.ScalarQuantizer.QT_8bit_direct_signed
"""FAISS's code for whole numbers from -128 to 127, which holds them exactly."""

_LARGEST_STEP = 127

_BLOCK = 65_536
"""Vectors converted at a time: all of a large index would take gigabytes."""


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
            Squared Euclidean distances, ascending, as exact as the search: queries may be rounded
            to the steps of the vectors.
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
        dimension = vectors.shape[1]
        self._factor = scale_factor(vectors)
        self._faiss: Any
        if self._factor == STEPS:
            # As exact as floats, in half the time.
            self._faiss = faiss.IndexScalarQuantizer(dimension, BYTES, faiss.METRIC_L2)
        else:
            self._faiss = faiss.IndexFlatL2(dimension)
        for block in _blocks(vectors):
            self._faiss.add(block * self._factor)

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query; see :meth:`Neighbours.search`.

        Among vectors that are bytes, queries are rounded to steps as well: some versions of FAISS
        drop what follows the point, and take a number beyond a byte's range for one from its other
        end.
        """
        scaled = np.ascontiguousarray(queries * self._factor, np.float32)
        if self._factor == STEPS:
            scaled = np.rint(scaled).clip(-_LARGEST_STEP, _LARGEST_STEP)
        squared, numbers = self._faiss.search(scaled, k)
        return squared / self._factor**2, numbers


def scale_factor(vectors: NDArray[np.floating]) -> np.float32:
    """The factor by which FAISS is given vectors ``(E, D)``.

    :data:`STEPS` where that makes every value a whole number that a byte holds, else 1.
    """
    for block in _blocks(vectors):
        steps = block * STEPS
        if np.abs(steps).max() > _LARGEST_STEP or not np.array_equal(steps, np.rint(steps)):
            return np.float32(1)
    return STEPS


def _blocks(vectors: NDArray[np.floating]) -> Iterator[NDArray[np.float32]]:
    for start in range(0, len(vectors), _BLOCK):
        yield np.ascontiguousarray(vectors[start : start + _BLOCK], np.float32)
