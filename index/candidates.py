"""The entries nearest to a silhouette, in each rotation that the person may have.

Few cameras of an index are rolled; rotating the query has the same effect. The mirror image of a
pose, seen by the mirror image of its camera, is as likely as the pose, so the mirror images of all
entries are searched as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import principal_axis_deg, rotate_silhouette
from index.skeleton import mirror_3d, mirror_normalised, rotate_clockwise, wrap_degrees
from index.store import PoseIndex


@dataclass(frozen=True)
class RotatedQuery:
    """A query silhouette with an assumed in-plane rotation of the person undone."""

    rotation_deg: float  # assumed rotation of the person, clockwise in the frame of the silhouette
    silhouette: NDArray[np.uint8]  # (128, 48): the silhouette with that rotation undone, normalised
    # (2, 3): affine transform from pixels of ``silhouette`` to pixels of the query.
    to_query: NDArray[np.float64]

    @classmethod
    def of(cls, silhouette: NDArray[np.uint8], rotation_deg: float) -> RotatedQuery:
        """Undo a rotation of a silhouette ``(128, 48)``."""
        if rotation_deg == 0:
            return cls(0.0, silhouette, np.eye(2, 3))
        return cls(rotation_deg, *rotate_silhouette(silhouette, -rotation_deg))


# Ratio of width to height from which a silhouette is searched both as it is and rotated.
_NEARLY_SQUARE = 0.75


def silhouette_rotations(silhouette: NDArray[np.uint8], roll_deg: float) -> tuple[float, ...]:
    """Rotations in degrees that a silhouette ``(128, 48)`` suggests on its own.

    The roll of its camera is not 0 if the silhouette was rotated upright.
    """
    if roll_deg:
        both_ends: tuple[float, ...] = (0.0, -180.0)
        unrolled, _ = rotate_silhouette(silhouette, -roll_deg)
        return (*both_ends, roll_deg) if _ratio(unrolled) < 1 / _NEARLY_SQUARE else both_ends
    if _ratio(silhouette) < _NEARLY_SQUARE:
        return (0.0,)
    axis_deg = principal_axis_deg(silhouette)
    return (0.0, axis_deg, float(wrap_degrees(axis_deg + 180.0)))


def _ratio(silhouette: NDArray[np.uint8]) -> float:
    _, _, width, height = cv2.boundingRect(silhouette)
    return width / max(height, 1)


def landmark_rotations(usual: tuple[float, ...], tilt_deg: float) -> tuple[float, ...]:
    """At most two rotations in degrees, for a trunk tilted by ``tilt_deg`` in the silhouette.

    The first is the first of the usual ones, from :func:`silhouette_rotations`. The second, if
    there is one, is that of the trunk, or the usual one that is nearly that.
    """
    apart = [abs(float(wrap_degrees(tilt_deg - one))) for one in usual]
    nearest = usual[apart.index(min(apart))]
    # Difference of a trunk's tilt from the usual rotations from which it is searched as well.
    second = nearest if min(apart) < 12.0 else tilt_deg
    return usual[:1] if second == usual[0] else (usual[0], second)


@dataclass(frozen=True)
class Candidates:
    """Entries near a query, nearest first; each is used as it is or mirrored."""

    entry_ids: NDArray[np.int64]  # (K,): rows of the index
    # (K,): whether the candidate is the mirror image of the entry; all other fields then describe
    # the mirror image.
    mirrored: NDArray[np.bool_]
    distances: NDArray[np.float64]  # (K,): Euclidean distances between descriptors, ascending
    # (K, D): descriptors of the candidates minus the descriptor of the query.
    offsets: NDArray[np.float32]
    # (K,): clockwise rotation in the picture that was applied to the points.
    rotation_deg: NDArray[np.float64]
    points_3d: NDArray[np.float64]  # (K, 24, 3): camera axes, metres, pelvis at the origin
    points_normalised: NDArray[np.float64]  # (K, 24, 2): pixels of the normalised frame

    def __len__(self) -> int:
        return len(self.entry_ids)

    def take(self, rows: NDArray[np.integer] | slice) -> Candidates:
        return Candidates(*(getattr(self, field.name)[rows] for field in fields(self)))


def find_candidates(index: PoseIndex, queries: Sequence[RotatedQuery], k: int) -> Candidates:
    """Find the ``k`` entries nearest to each rotation of a silhouette, in one search.

    Nearest first, with their skeletons rotated to fit the query.
    """
    vectors = _described(index, queries)
    variants = np.stack([vectors, index.descriptor.mirror(vectors)], axis=1)
    entry_ids, nearest_variant = index.search(variants, k)
    rows = np.arange(len(vectors)).repeat(entry_ids.shape[1])
    mirrored = nearest_variant.ravel() == 1
    return _candidates(index, queries, vectors, entry_ids.ravel(), mirrored, rows)


def sample_candidates(index: PoseIndex, queries: Sequence[RotatedQuery], count: int) -> Candidates:
    """A fixed sample of ``count`` entries and their mirror images, in each rotation.

    In place of :func:`find_candidates` for a silhouette that shows part of a body.
    """
    spaced = np.linspace(0, len(index) - 1, min(count, len(index))).astype(np.int64)
    every = np.meshgrid(np.arange(len(queries)), spaced, [0, 1], indexing="ij")
    rows, entry_ids, mirrored = (one.ravel() for one in every)
    return _candidates(index, queries, _described(index, queries), entry_ids, mirrored == 1, rows)


def _described(index: PoseIndex, queries: Sequence[RotatedQuery]) -> NDArray[np.float32]:
    """Descriptors ``(Q, D)`` of queries."""
    return index.descriptor.describe(np.stack([query.silhouette for query in queries]))


def _candidates(
    index: PoseIndex,
    queries: Sequence[RotatedQuery],
    vectors: NDArray[np.float32],
    entry_ids: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
    rows: NDArray[np.int64],
) -> Candidates:
    """Entries ``(K,)``, mirrored or not, each compared with and rotated as the query in its row."""
    candidates = _compare(index, vectors[rows], entry_ids, mirrored)
    for row, query in enumerate(queries):
        _rotate(candidates, rows == row, query)
    return candidates.take(np.argsort(candidates.distances, kind="stable"))


def _compare(
    index: PoseIndex,
    queries: NDArray[np.float32],
    entry_ids: NDArray[np.int64],
    mirrored: NDArray[np.bool_],
) -> Candidates:
    """Compare entries ``(K,)``, mirrored or not, each with its query ``(K, D)``, in this order.

    Distances are computed again, because searches and processors round differently.
    """
    vectors = index.vectors[entry_ids]
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


def _rotate(candidates: Candidates, chosen: NDArray[np.bool_], query: RotatedQuery) -> None:
    """Rotate the skeletons of chosen candidates ``(K,)`` as the query was rotated, in place."""
    if query.rotation_deg == 0:
        return
    linear, offset = query.to_query[:, :2], query.to_query[:, 2]
    points_3d, placed = candidates.points_3d, candidates.points_normalised
    candidates.rotation_deg[chosen] = query.rotation_deg
    points_3d[chosen] = rotate_clockwise(points_3d[chosen], query.rotation_deg)
    placed[chosen] = placed[chosen] @ linear.T + offset
