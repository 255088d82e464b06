"""The nearest vectors of a flat index, found among short lists of those that look near.

A flat index reads all its vectors for each query, some 23 MB, and most of the time goes into
reading. Here each value is also kept in 4 bits, as one of 16 steps of a grid, an eighth of that:
fast scan [1]_ goes through those in the processor's registers and names a few times as many
vectors as are asked for. Only of these the exact distances are computed, and the nearest kept.

What comes out is what the flat index gives unless a vector left out belongs among the nearest. It
would have to be nearer than it looks by more than every vector in the list is; where a query does
not rule that out, the flat index is asked after all. That is a guard, not a proof: where it let a
query pass, none was ever found to differ.

References
----------
.. [1] F. Andre, A.-M. Kermarrec, N. Le Scouarnec, "Cache locality is not enough: High-Performance
   Nearest Neighbor Search with Product Quantization Fast Scan", PVLDB 9(4), 2015.
"""

from __future__ import annotations

import os
from typing import Any, TypeAlias

# FAISS answers a single query slower and inexactly with several OpenMP threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import faiss
import numpy as np
from numpy.typing import NDArray

Found: TypeAlias = tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]

LISTED = 2.5
"""So many times as many vectors are listed for each variant of a query as are asked for."""

LEAST_LISTED = 400
"""A short list could not tell how far distances may be out."""

WORTHWHILE = 8
"""Shorter than the index by this factor, or the list saves nothing."""

_BITS = 4
_STEPS = 2**_BITS
# The grid covers all but this share of the values at either end, which are moved to its edge.
_BEYOND = 0.002
_SAMPLE = 4096
# Vectors encoded at once: bounds the memory in between.
_BLOCK = 8192


class NearestVectors:
    """Exact nearest neighbours by Euclidean distance; safe under several threads.

    Parameters
    ----------
    flat : faiss.IndexFlatL2
        Kept, and asked for all exact distances.
    """

    def __init__(self, flat: faiss.IndexFlatL2) -> None:
        # FAISS' stubs lack most of its methods.
        self._flat: Any = flat
        self._coarse = _coarse(flat) if flat.d % 2 == 0 else None

    def search(self, queries: NDArray[np.float32], k: int) -> Found:
        """The ``k`` nearest vectors to any variant of each query.

        Parameters
        ----------
        queries : (B, V, D) float32 array
            C-contiguous; ``V`` variants of each, and a vector may be near several.
        k : int
            At least 1; no more than ``V`` times all vectors are returned.

        Returns
        -------
        squared : (B, K) float32 array
            Squared distances, ascending.
        numbers : (B, K) int64 array
        variants : (B, K) int64 array
            Which variant each is so near to.
        """
        listed = max(round(LISTED * k), LEAST_LISTED)
        if self._coarse is None or WORTHWHILE * listed > self._flat.ntotal:
            return self._search_all(queries, k)
        count, variants, dimension = queries.shape
        each = queries.reshape(-1, dimension)
        rough, numbers = self._coarse.search(each, listed)
        exact = self._exact(each, numbers)
        found = _nearest_of(exact.reshape(count, variants, -1), numbers, k)
        missing = _may_miss(rough, exact, np.repeat(found[0][:, -1:], variants, axis=0))
        doubted = np.flatnonzero(missing.reshape(count, variants).any(axis=1))
        if len(doubted):
            anew = self._search_all(queries[doubted], k)
            found[0][doubted], found[1][doubted], found[2][doubted] = anew
        return found

    def _search_all(self, queries: NDArray[np.float32], k: int) -> Found:
        squared, numbers = self._flat.search(
            queries.reshape(-1, queries.shape[-1]), min(k, self._flat.ntotal)
        )
        return _nearest_of(squared.reshape(*queries.shape[:2], -1), numbers, k)

    def _exact(
        self, queries: NDArray[np.float32], numbers: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Squared distances ``(B, L)`` to some vectors, bit by bit those that a search gives."""
        exact = np.empty(numbers.shape, np.float32)
        self._flat.compute_distance_subset(
            len(queries),
            faiss.swig_ptr(queries),
            numbers.shape[1],
            faiss.swig_ptr(exact),
            faiss.swig_ptr(numbers),
        )
        return exact


def _nearest_of(distances: NDArray[np.float32], numbers: NDArray[np.int64], k: int) -> Found:
    """Leave the ``k`` nearest of all lists ``(B, V, L)`` of each query, ascending."""
    count, variants, listed = distances.shape
    k = min(k, variants * listed)
    near = np.empty((count, k), np.float32)
    named, nearest_to = np.empty((count, k), np.int64), np.empty((count, k), np.int64)
    names_of = numbers.reshape(count, -1)
    for row, (some, names) in enumerate(zip(distances.reshape(count, -1), names_of, strict=True)):
        within = np.flatnonzero(some <= np.partition(some, k - 1)[k - 1])
        # Of equals the flat index names the first first; of variants, the first comes first.
        order = within[np.lexsort((names[within], within // listed, some[within]))[:k]]
        near[row], named[row], nearest_to[row] = some[order], names[order], order // listed
    return near, named, nearest_to


def _may_miss(
    rough: NDArray[np.float32], exact: NDArray[np.float32], farthest: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Which lists ``(B, L)`` may lack one of the nearest of all vectors, ``(B,)``."""
    rough, exact, farthest = (np.sqrt(np.maximum(d, 0)) for d in (rough, exact, farthest))
    # Those left out look at least as far off as the last of the list.
    margin = rough.max(axis=1) - farthest[:, 0]
    return np.asarray(margin <= (rough - exact).max(axis=1))


def _coarse(flat: faiss.IndexFlatL2) -> Any:
    """The same vectors in 4 bits a value."""
    vectors = faiss.rev_swig_ptr(flat.get_xb(), flat.ntotal * flat.d).reshape(-1, flat.d)
    sample = vectors[:: max(1, len(vectors) // _SAMPLE)]
    low, high = np.quantile(sample, (_BEYOND, 1 - _BEYOND), axis=0).astype(np.float32)
    step = np.maximum((high - low) / _STEPS, np.float32(1e-9))
    codes = np.empty((len(vectors), flat.d // 2), np.uint8)
    for start in range(0, len(vectors), _BLOCK):
        rows = slice(start, start + _BLOCK)
        cells = np.clip((vectors[rows] - low) / step, 0, _STEPS - 1).astype(np.uint8)
        codes[rows] = cells[:, ::2] | cells[:, 1::2] << _BITS
    quantised: Any = faiss.IndexPQ(flat.d, flat.d, _BITS)
    middles = low[:, None] + step[:, None] * (np.arange(_STEPS, dtype=np.float32) + 0.5)
    faiss.copy_array_to_vector(middles.ravel(), quantised.pq.centroids)
    quantised.is_trained = True
    quantised.add_sa_codes(codes)
    return faiss.IndexPQFastScan(quantised)
