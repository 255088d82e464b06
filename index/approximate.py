"""Approximate searches, for indexes too large to compare a query with every vector.

Both find nearly all of the nearest vectors [1]_ [2]_. They hold the same codes as the exact search,
so the distances of what they find are exact.

References
----------
.. [1] J. Sivic, A. Zisserman, "Video Google: A Text Retrieval Approach to Object Matching in
   Videos", ICCV 2003.
.. [2] Y. A. Malkov, D. A. Yashunin, "Efficient and Robust Approximate Nearest Neighbor Search
   Using Hierarchical Navigable Small World Graphs", IEEE TPAMI 42(4), 2020.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isqrt
from typing import Any, ClassVar

import faiss
import numpy as np
from numpy.typing import NDArray

from index.neighbours import BYTES, STEPS, add_scaled, scale_factor, scaled_queries

_TRAINED_PER_LIST = 64
_SEED = 2016


@dataclass(frozen=True)
class Ivf:
    """Inverted lists: each vector is in the list of its nearest centroid, few lists are searched.

    Parameters
    ----------
    nlist : int
        Number of lists.
    nprobe : int
        Lists searched for each query.
    """

    kind: ClassVar[str] = "ivf"
    nlist: int
    nprobe: int

    def __post_init__(self) -> None:
        if not 1 <= self.nprobe <= self.nlist:
            raise ValueError(f"expected nprobe from 1 to nlist, got {self.nprobe} of {self.nlist}")

    @classmethod
    def suited(cls, count: int) -> Ivf:
        """Choose parameters for ``count`` vectors; measured in docs/results/embedded-index.md."""
        nlist = min(count, 2 * isqrt(count))
        return cls(nlist, min(64, nlist))

    def train(self, vectors: NDArray[np.floating], factor: np.float32) -> Any:
        """Make empty lists about centroids of vectors ``(E, D)``, found by k-means.

        The index takes vectors multiplied by ``factor``.
        """
        dimension = vectors.shape[1]
        quantizer = faiss.IndexFlatL2(dimension)
        index: Any
        if factor == STEPS:
            index = faiss.IndexIVFScalarQuantizer(
                quantizer, dimension, self.nlist, BYTES, faiss.METRIC_L2, False
            )
        else:
            index = faiss.IndexIVFFlat(quantizer, dimension, self.nlist)
        # FAISS would warn of small lists, and take another sample.
        index.cp.min_points_per_centroid = 1
        index.cp.max_points_per_centroid = _TRAINED_PER_LIST
        size = min(len(vectors), self.nlist * _TRAINED_PER_LIST)
        sample = np.random.default_rng(_SEED).choice(len(vectors), size, replace=False)
        index.train(vectors[np.sort(sample)].astype(np.float32) * factor)
        return index

    def check(self, index: Any, factor: np.float32) -> None:
        """Raise ValueError if :meth:`train` did not make an index read from a file."""
        _expect_type(
            index, faiss.IndexIVFScalarQuantizer if factor == STEPS else faiss.IndexIVFFlat
        )
        _expect_type(faiss.downcast_index(index.quantizer), faiss.IndexFlatL2)
        if factor == STEPS and (index.sq.qtype != BYTES or index.by_residual):
            raise ValueError("expected inverted lists of exact codes")
        if index.nlist != self.nlist:
            raise ValueError(f"expected {self.nlist} inverted lists, got {index.nlist}")

    def apply(self, index: Any) -> None:
        """Set how many lists are searched."""
        index.nprobe = self.nprobe

    def exhaustive(
        self, index: Any, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Compare queries ``(Q, D)`` with all vectors of an index."""
        every = faiss.SearchParametersIVF()
        every.nprobe = self.nlist
        squared, numbers = index.search(queries, k, params=every)
        return squared, numbers


@dataclass(frozen=True)
class Hnsw:
    """A hierarchical navigable small-world graph, walked towards the query.

    Parameters
    ----------
    m : int
        Links of a vector, twice as many in the lowest layer.
    ef_construction, ef_search : int
        Candidates kept while a vector is linked, and while a query is searched for.
    """

    kind: ClassVar[str] = "hnsw"
    m: int
    ef_construction: int
    ef_search: int

    def __post_init__(self) -> None:
        if self.m < 2 or self.ef_construction < 1 or self.ef_search < 1:
            raise ValueError(f"expected m of at least 2 and ef of at least 1, got {self}")

    @classmethod
    def suited(cls, count: int) -> Hnsw:
        """Choose parameters for ``count`` vectors; measured in docs/results/embedded-index.md."""
        del count  # The same suit every size.
        return cls(m=16, ef_construction=80, ef_search=256)

    def train(self, vectors: NDArray[np.floating], factor: np.float32) -> Any:
        """Make an empty graph; see :meth:`Ivf.train`. Nothing is learned but the links."""
        dimension = vectors.shape[1]
        # The stubs of FAISS know other arguments.
        in_bytes: Any = faiss.IndexHNSWSQ
        index: Any
        if factor == STEPS:
            index = in_bytes(dimension, BYTES, self.m)
        else:
            index = faiss.IndexHNSWFlat(dimension, self.m)
        index.hnsw.efConstruction = self.ef_construction
        return index

    def check(self, index: Any, factor: np.float32) -> None:
        """See :meth:`Ivf.check`."""
        storage: Any = faiss.downcast_index(getattr(index, "storage", index))
        if factor == STEPS:
            _expect_type(index, faiss.IndexHNSWSQ)
            _expect_type(storage, faiss.IndexScalarQuantizer)
            if storage.sq.qtype != BYTES:
                raise ValueError("expected a graph of exact codes")
        else:
            _expect_type(index, faiss.IndexHNSWFlat)
            _expect_type(storage, faiss.IndexFlatL2)
        if index.hnsw.nb_neighbors(1) != self.m:
            raise ValueError(f"expected {self.m} links, got {index.hnsw.nb_neighbors(1)}")

    def apply(self, index: Any) -> None:
        """Set how many candidates a search keeps."""
        index.hnsw.efSearch = self.ef_search

    def exhaustive(
        self, index: Any, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """See :meth:`Ivf.exhaustive`."""
        squared, numbers = index.storage.search(queries, k)
        return squared, numbers


Method = Ivf | Hnsw

METHODS: dict[str, type[Method]] = {method.kind: method for method in (Ivf, Hnsw)}


class ApproximateNeighbours:
    """Searches a part of the vectors, in this process; as safe under threads as FAISS.

    Where that part holds fewer than ``k``, the query is compared with all of them instead.

    Parameters
    ----------
    method : Ivf or Hnsw
    index : FAISS index
        Made by the method and filled.
    factor : float32
        By which its vectors were multiplied; see :func:`index.neighbours.scale_factor`.
    """

    def __init__(self, method: Method, index: Any, factor: np.float32) -> None:
        method.apply(index)
        self.method = method
        self._faiss, self._factor = index, factor

    @classmethod
    def build(cls, vectors: NDArray[np.floating], method: Method) -> ApproximateNeighbours:
        """Train on vectors ``(E, D)`` and add them; on one thread always the same way."""
        factor = scale_factor(vectors)
        index = method.train(vectors, factor)
        add_scaled(index, vectors, factor)
        return cls(method, index, factor)

    @classmethod
    def restore(
        cls, search: Mapping[str, object], content: NDArray[np.uint8], vectors: NDArray[np.floating]
    ) -> ApproximateNeighbours:
        """Undo :meth:`parameters` and :meth:`to_bytes`; trains and links nothing.

        Parameters
        ----------
        search : mapping
            JSON values of the manifest.
        content : (B,) uint8 array
        vectors : (E, D) float array
            Those it was built from.

        Raises
        ------
        ValueError, TypeError
            If these do not fit each other.
        """
        method = method_of(search)
        index = faiss.deserialize_index(content)
        factor = scale_factor(vectors)
        method.check(index, factor)
        if (index.ntotal, index.d) != vectors.shape:
            raise ValueError(
                f"expected a search of vectors {vectors.shape}, got {(index.ntotal, index.d)}"
            )
        return cls(method, index, factor)

    def parameters(self) -> dict[str, object]:
        """JSON values from which :meth:`restore` makes the same search."""
        return {"kind": self.method.kind, **asdict(self.method)}

    def to_bytes(self) -> bytes:
        """What was trained and linked, and the vectors, as FAISS writes them."""
        return bytes(faiss.serialize_index(self._faiss))

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find ``k`` vectors near each query; see :meth:`index.neighbours.Neighbours.search`."""
        scaled = scaled_queries(queries, self._factor)
        squared, numbers = self._faiss.search(scaled, k)
        # FAISS numbers with -1 what it did not find.
        short = numbers[:, -1] < 0
        if short.any():
            squared[short], numbers[short] = self.method.exhaustive(self._faiss, scaled[short], k)
        return squared / self._factor**2, numbers


def method_of(search: Mapping[str, object]) -> Method:
    """The method that a manifest names."""
    kind, parameters = search.get("kind"), {k: v for k, v in search.items() if k != "kind"}
    if kind not in METHODS:
        raise ValueError(f"expected a search of kind flat, {', '.join(METHODS)}, got {kind!r}")
    return METHODS[str(kind)](**parameters)  # type: ignore[arg-type]


def _expect_type(index: Any, kind: type) -> None:
    if type(index) is not kind:
        raise ValueError(f"expected a FAISS {kind.__name__}, got {type(index).__name__}")
