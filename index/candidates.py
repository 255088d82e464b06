"""The nearest entries to a silhouette, and to its mirror image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from index.skeleton import mirror_3d, mirror_normalised
from index.store import PoseIndex


@dataclass(frozen=True)
class Candidates:
    """Entries near a query, best first; an entry may come as its mirror image.

    Parameters
    ----------
    query : (D,) float32 array
    numbers : (K,) int64 array
        Entries.
    mirrored : (K,) bool array
        Whether the mirror image of the entry is meant, here and in all that follows.
    distances : (K,) float64 array
        Euclidean distances of the descriptors, ascending.
    vectors : (K, D) float32 array
    points_3d : (K, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin.
    points_normalised : (K, 24, 2) float64 array
        Pixels of the normalised frame.
    """

    query: NDArray[np.float32]
    numbers: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
    distances: NDArray[np.float64]
    vectors: NDArray[np.float32]
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.numbers)


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
    query = index.descriptor.describe(silhouette[None])
    both = np.concatenate([query, index.descriptor.mirror(query)])
    distances, numbers = index.search(both, k)
    mirrored = np.repeat([False, True], distances.shape[1])
    nearest = np.argsort(distances.ravel(), kind="stable")[:k]
    numbers, mirrored = numbers.ravel()[nearest], mirrored[nearest]
    vectors = index.vectors[numbers].copy()
    points_3d, points_normalised = index.points(numbers)
    vectors[mirrored] = index.descriptor.mirror(vectors[mirrored])
    points_3d[mirrored] = mirror_3d(points_3d[mirrored])
    points_normalised[mirrored] = mirror_normalised(points_normalised[mirrored])
    return Candidates(
        query[0],
        numbers,
        mirrored,
        distances.ravel()[nearest].astype(np.float64),
        vectors,
        points_3d,
        points_normalised,
    )
