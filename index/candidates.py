"""The entries and mirror images of entries nearest to a silhouette."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from index.skeleton import mirror_3d, mirror_normalised
from index.store import PoseIndex


@dataclass(frozen=True)
class Candidates:
    """Entries near a query, nearest first; each is used as it is or mirrored.

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


def find_candidates(index: PoseIndex, silhouette: NDArray[np.uint8], k: int) -> Candidates:
    """Find the ``k`` nearest among all entries and all their mirror images, or all if fewer."""
    vectors = index.descriptor.describe(silhouette[None])
    entry_ids, mirrored, rows = nearest_entries(index, vectors, k)
    return compare_entries(index, vectors[rows], entry_ids, mirrored).in_order()


def nearest_entries(
    index: PoseIndex, vectors: NDArray[np.float32], k: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Find the ``k`` entries nearest to each of several descriptors ``(Q, D)`` in one search.

    The mirror image of a pose, seen by the mirror image of its camera, is as likely as the pose.
    Searching for the mirrored descriptor as well doubles the poses that an index covers.

    Returns
    -------
    entry_ids : (K,) int64 array
    mirrored : (K,) bool array
        Whether the mirror image of the entry was found.
    rows : (K,) int64 array
        Row of the descriptor to which each entry is near.
    """
    variants = np.stack([vectors, index.descriptor.mirror(vectors)], axis=1)
    _, entry_ids, nearest_variant = index.search(variants, k)
    rows = np.arange(len(vectors)).repeat(entry_ids.shape[1])
    return entry_ids.ravel(), nearest_variant.ravel() == 1, rows


def compare_entries(
    index: PoseIndex,
    queries: NDArray[np.float32],
    entry_ids: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
) -> Candidates:
    """Compare entries ``(K,)``, mirrored or not, each with its query ``(K, D)``, in this order.

    Distances are computed again, because searches and processors round differently.
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
