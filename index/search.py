"""Exact nearest-neighbour search among descriptors."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import faiss
import numpy as np
from numpy.typing import NDArray

STEPS_PER_UNIT = np.float32(8)
"""Values of descriptors are multiples of 1/8, far below the effect of noise: files compress to a
quarter, and a byte holds each value exactly."""

_MAX_STEPS = 127

_ZERO = np.float32(128)
"""Added to whole numbers from -127 to 127, since FAISS compares unsigned bytes faster."""

_VECTORS_PER_BLOCK = 65_536
"""Vectors converted at a time: converting all of a large index would take gigabytes."""


class SearchUnavailableError(Exception):
    """A search on a server failed, but may succeed later; the message is for the operator."""


class Neighbours(Protocol):
    """A search among a fixed set of vectors; thread-safe."""

    def __len__(self) -> int:
        """Number of vectors."""

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Squared distances, ascending, and rows ``(Q, k)`` of the nearest of queries ``(Q, D)``.

        Parameters
        ----------
        queries : (Q, D) float32 array
        k : int
            From 1 to the number of vectors.

        Returns
        -------
        squared : (Q, k) float32 array
            Squared Euclidean distances, ascending.
        ids : (Q, k) int64 array
            Rows of the vectors.

        Raises
        ------
        SearchUnavailableError
            If the search runs on a server that does not answer.
        """


class ExactNeighbours:
    """Vectors ``(E, D)``; compares each query with all of them, in this process.

    ``in_bytes`` is whether vectors that are multiples of 1/8 are stored as bytes, which take a
    quarter of the memory and half the time; queries are then rounded, too. Otherwise FAISS's
    ``IndexFlatL2`` searches them, and queries are not rounded.
    """

    def __init__(self, vectors: NDArray[np.floating], *, in_bytes: bool = True) -> None:
        self._factor = scale_factor(vectors) if in_bytes else np.float32(1)
        self._in_bytes = self._factor == STEPS_PER_UNIT
        self._faiss: Any = faiss.IndexFlatL2(vectors.shape[1])
        if self._in_bytes:  # Whole numbers from 0 to 255 are stored exactly.
            code = faiss.ScalarQuantizer.QT_8bit_direct
            self._faiss = faiss.IndexScalarQuantizer(vectors.shape[1], code, faiss.METRIC_L2)
        for block in _blocks(vectors):
            scaled = block * self._factor
            with _one_thread():
                self._faiss.add(scaled + _ZERO if self._in_bytes else scaled)
        # FAISS takes nine times as long to decode a few vectors.
        size = self._faiss.code_size
        stored = faiss.rev_swig_ptr(self._faiss.codes.data(), len(self) * size)
        self._stored: NDArray[np.uint8] = stored.reshape(len(self), size)

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    @property
    def rounds_queries(self) -> bool:
        return self._in_bytes

    @property
    def shape(self) -> tuple[int, int]:
        """Number of vectors, and of their values."""
        return len(self), int(self._faiss.d)

    def __getitem__(self, rows: NDArray[np.integer] | Sequence[int] | slice) -> NDArray[np.float32]:
        """The vectors of these rows, as they were given."""
        stored = self._stored[rows]
        if self._in_bytes:
            return (stored.astype(np.float32) - _ZERO) / self._factor
        return stored.view(np.float32)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query, rounded; see :meth:`Neighbours.search`."""
        scaled = np.ascontiguousarray(self.rounded(queries) * self._factor, np.float32)
        with _one_thread():  # With more, FAISS takes longer for few queries.
            squared, ids = self._faiss.search(scaled + _ZERO if self._in_bytes else scaled, k)
        return squared / self._factor**2, ids

    def rounded(self, queries: NDArray[np.float32]) -> NDArray[np.float32]:
        """The queries ``(Q, D)`` in the steps of the vectors, if these are bytes.

        Some versions of FAISS truncate the fraction and let numbers beyond a byte's range overflow.
        """
        if not self._in_bytes:
            return queries
        steps = np.rint(queries * self._factor).clip(-_MAX_STEPS, _MAX_STEPS)
        return np.asarray(steps / self._factor)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let FAISS work in this thread alone, and restore the caller's number of threads.

    A forked process would wait for ever for the OpenMP threads of its parent.
    """
    threads = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(threads)


def scale_factor(vectors: NDArray[np.floating]) -> np.float32:
    """Factor by which vectors ``(E, D)`` are multiplied for FAISS.

    :data:`STEPS_PER_UNIT` if that makes every value a whole number that fits a byte, else 1.
    """
    for block in _blocks(vectors):
        steps = block * STEPS_PER_UNIT
        if np.abs(steps).max() > _MAX_STEPS or not np.array_equal(steps, np.rint(steps)):
            return np.float32(1)
    return STEPS_PER_UNIT


def _blocks(vectors: NDArray[np.floating]) -> Iterator[NDArray[np.float32]]:
    for start in range(0, len(vectors), _VECTORS_PER_BLOCK):
        yield np.ascontiguousarray(vectors[start : start + _VECTORS_PER_BLOCK], np.float32)
