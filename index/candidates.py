"""The nearest entries to a silhouette, and to its mirror image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from index.skeleton import mirror_3d, mirror_normalised
from index.store import PoseIndex


@dataclass(frozen=True)
class Candidates:
    """Entries near a query, best first; an entry may come as its mirror image.

    Parameters
    ----------
    numbers : (K,) int64 array
        Entries.
    mirrored : (K,) bool array
        Whether the mirror image of the entry is meant, here and in all that follows.
    distances : (K,) float64 array
        Euclidean distances of the descriptors, ascending.
    offsets : (K, D) float32 array
        From the query's descriptor to each one's.
    lean_deg : (K,) float64 array
        How far each is turned clockwise in the picture, which its points are already.
    points_3d : (K, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin.
    points_normalised : (K, 24, 2) float64 array
        Pixels of the normalised frame.
    """

    numbers: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
    distances: NDArray[np.float64]
    offsets: NDArray[np.float32]
    lean_deg: NDArray[np.float64]
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.numbers)

    def take(self, rows: NDArray[np.integer] | slice) -> Candidates:
        """Return some of them, in the order asked for."""
        return Candidates(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def merged(cls, some: Sequence[Candidates]) -> Candidates:
        """Put the candidates of several queries together, in ascending distance."""
        if len(some) == 1:
            return some[0]
        names = [field.name for field in fields(cls)]
        every = cls(*(np.concatenate([getattr(one, name) for one in some]) for name in names))
        return every.take(np.argsort(every.distances, kind="stable"))

    def unique(self) -> Candidates:
        """Return each entry, mirrored or not and leaning so far, once."""
        same = np.stack([self.numbers, self.mirrored, self.lean_deg], axis=1)
        return self.take(np.sort(np.unique(same, axis=0, return_index=True)[1]))


def find_candidates(index: PoseIndex, silhouette: NDArray[np.uint8], k: int) -> Candidates:
    """Find the ``k`` nearest among all entries and all their mirror images.

    Asking for the mirrored silhouette as well doubles what an index knows: the mirror image
    of a pose, seen by the mirror image of its camera, is as likely as the pose.

    Parameters
    ----------
    index : PoseIndex
    silhouette : (128, 48) uint8 array
    k : int
        Fewer are returned only where the index has fewer.
    """
    return find_candidates_of_each(index, silhouette[None], k)[0]


def find_candidates_of_each(
    index: PoseIndex, silhouettes: NDArray[np.uint8], k: int
) -> list[Candidates]:
    """Ask for several silhouettes ``(B, 128, 48)`` at once, which is sooner done than one by one.

    See :func:`find_candidates`.
    """
    queries = index.descriptor.describe(silhouettes)
    both = np.stack([queries, index.descriptor.mirror(queries)], axis=1)
    distances, nearest, variants = index.search(both, k)
    of_query = np.repeat(queries, nearest.shape[1], axis=0)
    every = _candidates(index, nearest.ravel(), variants.ravel() == 1, of_query, distances.ravel())
    ends = nearest.shape[1] * np.arange(len(queries) + 1)
    return [every.take(slice(*pair)) for pair in pairwise(ends.tolist())]


def candidates_of(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    numbers: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
) -> Candidates:
    """Compare a silhouette ``(128, 48)`` with entries ``(K,)`` that were found in another way."""
    queries = np.repeat(index.descriptor.describe(silhouette[None]), len(numbers), axis=0)
    unordered = _candidates(index, numbers, mirrored, queries)
    return unordered.take(np.argsort(unordered.distances, kind="stable"))


def _candidates(
    index: PoseIndex,
    numbers: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
    queries: NDArray[np.float32],
    distances: NDArray[np.float32] | None = None,
) -> Candidates:
    """Entries ``(K,)`` beside a query of each, ``(K, D)``; distances are computed if not given."""
    vectors = index.vectors[numbers]
    points_3d, points_normalised = index.points(numbers)
    vectors[mirrored] = index.descriptor.mirror(vectors[mirrored])
    points_3d[mirrored] = mirror_3d(points_3d[mirrored])
    points_normalised[mirrored] = mirror_normalised(points_normalised[mirrored])
    offsets = vectors - queries
    if distances is None:
        distances = np.linalg.norm(offsets, axis=1)
    return Candidates(
        numbers,
        mirrored,
        distances.astype(np.float64),
        offsets,
        np.zeros(len(numbers)),
        points_3d,
        points_normalised,
    )
