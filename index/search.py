"""Exact nearest-neighbour search: by descriptor, and by landmarks in three dimensions.

A silhouette does not show the limbs inside its outline, and landmarks do not show the outline. Each
search therefore finds entries that the other misses.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import faiss
import numpy as np
from numpy.typing import NDArray

from index.skeleton import LIMB_HIPS, LIMBS, SIDES, other_side, rotate_clockwise, rows

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
        """Find the ``k`` vectors nearest to each query.

        Parameters
        ----------
        queries : (Q, D) float32 array
        k : int
            From 1 to the number of vectors.

        Returns
        -------
        squared : (Q, k) float32 array
            Squared Euclidean distances, ascending. A search may round queries to the steps of the
            vectors.
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
        dimension = vectors.shape[1]
        self._factor = scale_factor(vectors) if in_bytes else np.float32(1)
        self._in_bytes = self._factor == STEPS_PER_UNIT
        empty = _byte_index if self._in_bytes else faiss.IndexFlatL2
        self._faiss: Any = empty(dimension)
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
        """Whether the vectors are bytes."""
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
        """Find the ``k`` vectors nearest to each query; see :meth:`Neighbours.search`.

        If the vectors are bytes, queries are rounded to steps as well: some versions of FAISS
        truncate the fraction and let numbers beyond a byte's range overflow.
        """
        scaled = np.ascontiguousarray(queries * self._factor, np.float32)
        if self._in_bytes:
            scaled = np.rint(scaled).clip(-_MAX_STEPS, _MAX_STEPS) + _ZERO
        squared, ids = _search(self._faiss, scaled, k)
        return squared / self._factor**2, ids


def _search(
    vectors: Any, queries: NDArray[np.float32], k: int
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    with _one_thread():  # With more, FAISS takes longer for few queries.
        squared, ids = vectors.search(queries, k)
    return squared, ids


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let FAISS work in this thread alone.

    A forked process would wait for ever for the OpenMP threads of its parent. Each thread has its
    own number of them; that of the caller is restored.
    """
    threads = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(threads)


def _byte_index(dimension: int) -> Any:
    """An empty index of whole numbers from 0 to 255, which it stores exactly."""
    code = faiss.ScalarQuantizer.QT_8bit_direct
    return faiss.IndexScalarQuantizer(dimension, code, faiss.METRIC_L2)


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


STEPS_PER_BODY = 150.0
"""Steps in a body's size. Coordinates are whole numbers of steps, so that a byte holds each. A step
is about a centimetre, far less than the error of landmarks."""

LANDMARK_DIMENSION = 48
"""Values of a vector: three for each limb joint, then zeros, because FAISS compares vectors of a
multiple of 16 bytes twelve times faster than others."""

_BONES = [
    rows(f"{side}_{start}", f"{side}_{end}", among=LIMBS)
    for side in SIDES
    for start, end in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("shoulder", "hip"),
        ("hip", "knee"),
        ("knee", "ankle"),
    )
]
_HEIGHT_PER_BONES = 1.7 / 3.6
"""A body 1.7 m tall measures 3.6 m along shoulder to wrist, shoulder to hip and hip to ankle, both
sides."""

_OTHER_SIDE = rows(*(other_side(name) for name in LIMBS), among=LIMBS)


@dataclass(frozen=True)
class NearestEntries:
    """Entries nearest to landmarks, nearest first."""

    entry_ids: NDArray[np.int64]  # (K,)
    mirrored: NDArray[np.bool_]  # (K,): whether the mirror image of the entry was found
    # (K,): clockwise rotation in the picture of the entry found, as seen by a camera that is not
    # rolled.
    roll_deg: NDArray[np.float64]


class LandmarkSearch:
    """Exhaustive search over skeletons of one size, about the hips; immutable.

    Their vectors ``(E, 48)``, from :func:`pose_vectors`, are as seen by cameras that are not
    rolled.
    """

    def __init__(self, vectors: NDArray[np.float32]) -> None:
        if vectors.ndim != 2 or vectors.shape[1] != LANDMARK_DIMENSION:
            raise ValueError(
                f"expected vectors of shape (E, {LANDMARK_DIMENSION}), got {vectors.shape}"
            )
        self._faiss = _byte_index(LANDMARK_DIMENSION)
        for block in _blocks(vectors):
            with _one_thread():
                self._faiss.add(block + _ZERO)

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    def nearest(
        self, points_3d: NDArray[np.float64], rolls_deg: tuple[float, ...], k: int
    ) -> NearestEntries:
        """Find the ``k`` nearest among all entries and their mirror images.

        Limbs ``(12, 3)`` are in camera axes, with any origin and unit; the person may be rotated
        clockwise in the picture by any of ``rolls_deg``.
        """
        queries = []
        for roll_deg in rolls_deg:
            unrolled = rotate_clockwise(points_3d, -roll_deg)
            queries += [unrolled, mirrored_limbs(unrolled)]
        k = min(k, len(self))
        squared, ids = _search(self._faiss, pose_vectors(np.stack(queries)) + _ZERO, k)
        variants = np.repeat(np.arange(len(queries)), k)
        squared, ids = squared.ravel(), ids.ravel()
        order = np.lexsort((ids, variants, squared))[:k]
        variants = variants[order]
        return NearestEntries(ids[order], variants % 2 == 1, np.array(rolls_deg)[variants // 2])


def pose_vectors(points_3d: NDArray[np.floating]) -> NDArray[np.float32]:
    """Skeletons ``(N, 12, 3)`` as vectors ``(N, 48)`` of whole numbers, about the hips."""
    points = points_3d - points_3d[:, LIMB_HIPS].mean(axis=1, keepdims=True)
    size = body_sizes(points_3d)[:, None, None]
    steps = np.rint(points * (STEPS_PER_BODY / size))
    vectors = np.zeros((len(points), LANDMARK_DIMENSION), np.float32)
    flat = np.clip(steps, -_MAX_STEPS, _MAX_STEPS).reshape(len(points), -1)
    vectors[:, : flat.shape[1]] = flat
    return vectors


def body_sizes(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Sizes ``(N,)`` of bodies with limbs ``(N, 12, 3)``: about their heights."""
    lengths = sum(
        np.linalg.norm(points_3d[:, start] - points_3d[:, end], axis=-1) for start, end in _BONES
    )
    return np.asarray(np.maximum(lengths, 1e-6) * _HEIGHT_PER_BONES, np.float64)


def mirrored_limbs(points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mirror image of limbs ``(12, 3)`` in camera axes."""
    mirrored = points_3d[_OTHER_SIDE].copy()
    mirrored[:, 0] *= -1
    return mirrored
