"""The entries and mirror images of entries nearest to a silhouette."""

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
    """Entries near a query, nearest first; each as it is or mirrored.

    Parameters
    ----------
    entry_ids : (K,) int64 array
        Rows of the index.
    mirrored : (K,) bool array
        Whether the candidate is the mirror image of the entry; all other fields then describe the
        mirror image.
    distances : (K,) float64 array
        Euclidean distances between descriptors, ascending.
    offsets : (K, D) float32 array
        Descriptors of the candidates minus the descriptor of the query.
    rotation_deg : (K,) float64 array
        Clockwise rotation in the picture that was applied to the points.
    points_3d : (K, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin.
    points_normalised : (K, 24, 2) float64 array
        Pixels of the normalised frame.
    """

    entry_ids: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
    distances: NDArray[np.float64]
    offsets: NDArray[np.float32]
    rotation_deg: NDArray[np.float64]
    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.entry_ids)

    def take(self, rows: NDArray[np.integer] | slice) -> Candidates:
        """Select candidates by row, in the order given."""
        return Candidates(*(getattr(self, field.name)[rows] for field in fields(self)))

    def in_order(self) -> Candidates:
        """Sort by distance; candidates at the same distance keep their order."""
        return self.take(np.argsort(self.distances, kind="stable"))

    @classmethod
    def merged(cls, parts: Sequence[Candidates]) -> Candidates:
        """Merge the candidates of several queries, nearest first."""
        if len(parts) == 1:
            return parts[0]
        names = [field.name for field in fields(cls)]
        merged = cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
        return merged.in_order()

    def unique(self) -> Candidates:
        """Drop repetitions of an entry with the same mirroring and rotation."""
        keys = np.stack([self.entry_ids, self.mirrored, self.rotation_deg], axis=1)
        return self.take(np.sort(np.unique(keys, axis=0, return_index=True)[1]))


def find_candidates(index: PoseIndex, silhouette: NDArray[np.uint8], k: int) -> Candidates:
    """Find the ``k`` nearest among all entries and all their mirror images, or all if fewer.

    The mirror image of a pose, seen by the mirror image of its camera, is as likely as the pose.
    Searching for the mirrored silhouette ``(128, 48)`` as well doubles the poses that an index
    covers.
    """
    return find_candidates_of_each(index, silhouette[None], k)[0]


def find_candidates_of_each(
    index: PoseIndex, silhouettes: NDArray[np.uint8], k: int
) -> list[Candidates]:
    """Find the candidates of each silhouette of a batch ``(B, 128, 48)`` in one search.

    See :func:`find_candidates`.
    """
    queries = index.descriptor.describe(silhouettes)
    variants = np.stack([queries, index.descriptor.mirror(queries)], axis=1)
    _, entry_ids, nearest_variant = index.search(variants, k)
    count = entry_ids.shape[1]
    found = _candidates(
        index, entry_ids.ravel(), nearest_variant.ravel() == 1, np.repeat(queries, count, axis=0)
    )
    ends = count * np.arange(len(queries) + 1)
    return [found.take(slice(*pair)).in_order() for pair in pairwise(ends.tolist())]


def compare_entries(
    index: PoseIndex,
    silhouette: NDArray[np.uint8],
    entry_ids: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
) -> Candidates:
    """Compare a silhouette ``(128, 48)`` with given entries ``(K,)``, mirrored or not."""
    queries = np.repeat(index.descriptor.describe(silhouette[None]), len(entry_ids), axis=0)
    return _candidates(index, entry_ids, mirrored, queries).in_order()


def _candidates(
    index: PoseIndex,
    entry_ids: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
    queries: NDArray[np.float32],
) -> Candidates:
    """Entries ``(K,)``, each with its query ``(K, D)``, in the order given.

    Distances are computed anew, because searches round in different ways, also between processors.
    """
    vectors = index.vectors[entry_ids].astype(np.float32)
    points_3d, points_normalised = index.points(entry_ids)
    vectors[mirrored] = index.descriptor.mirror(vectors[mirrored])
    points_3d[mirrored] = mirror_3d(points_3d[mirrored])
    points_normalised[mirrored] = mirror_normalised(points_normalised[mirrored])
    offsets = vectors - queries
    return Candidates(
        entry_ids,
        mirrored,
        np.linalg.norm(offsets.astype(np.float64), axis=1),
        offsets,
        np.zeros(len(entry_ids)),
        points_3d,
        points_normalised,
    )
