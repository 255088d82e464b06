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
from index.search import NearestEntries
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
    """Width over height of a silhouette's bounding box."""
    _, _, width, height = cv2.boundingRect(silhouette)
    return width / max(height, 1)


ROTATION_STEP_DEG = 15.0
"""With landmarks, rotations are searched in multiples of this."""

MAX_ROTATIONS = 2
"""Most rotations that are searched with landmarks."""

MIN_ROTATION_SHARE = 0.2
"""Smallest share of the entries near the landmarks for which a rotation is searched."""


def landmark_rotations(usual: Sequence[float], roll_deg: NDArray[np.float64]) -> list[float]:
    """Rotations in degrees that the entries near the landmarks suggest, most frequent first.

    They are the usual ones, from :func:`silhouette_rotations`, or multiples of
    :data:`ROTATION_STEP_DEG`. The rotations ``(K,)`` of the entries are those of
    :class:`index.search.NearestEntries`.
    """
    rounded = wrap_degrees(np.rint(roll_deg / ROTATION_STEP_DEG) * ROTATION_STEP_DEG)
    apart = np.abs(wrap_degrees(rounded[:, None] - np.array(usual)))
    nearest = np.array(usual)[apart.argmin(axis=1)]
    rounded = np.where(apart.min(axis=1) <= ROTATION_STEP_DEG / 2, nearest, rounded)
    rotations, counts = np.unique(rounded, return_counts=True)
    order = np.argsort(-counts, kind="stable")[:MAX_ROTATIONS]
    likely = rotations[order][counts[order] >= MIN_ROTATION_SHARE * len(rounded)]
    return [float(one) for one in (likely if len(likely) else rotations[order[:1]])]


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
        """Select candidates by row, in the order given."""
        return Candidates(*(getattr(self, field.name)[rows] for field in fields(self)))


def find_candidates(
    index: PoseIndex,
    queries: Sequence[RotatedQuery],
    k: int,
    nearest: NearestEntries | None = None,
) -> Candidates:
    """Find the ``k`` entries nearest to each rotation of a silhouette, and compare other entries.

    ``nearest`` are entries near the landmarks; each is compared with the rotation nearest to its
    own. With a ``k`` of 0, only these are returned. Each candidate is listed once, nearest first,
    with its skeleton rotated to fit the query.
    """
    vectors = index.descriptor.describe(np.stack([query.silhouette for query in queries]))
    found = []
    if nearest is not None:
        rotations_deg = np.array([query.rotation_deg for query in queries])
        apart = np.abs(wrap_degrees(nearest.roll_deg[:, None] - rotations_deg))
        found.append((nearest.entry_ids, nearest.mirrored, apart.argmin(axis=1)))
    if k:
        found.append(_nearest_entries(index, vectors, k))
    entry_ids, mirrored, rows = (np.concatenate(parts) for parts in zip(*found, strict=True))
    keys = (2 * entry_ids + mirrored) * len(queries) + rows
    once = np.sort(np.unique(keys, return_index=True)[1])
    rows = rows[once]
    candidates = _compare(index, vectors[rows], entry_ids[once], mirrored[once])
    for row, query in enumerate(queries):
        _rotate(candidates, rows == row, query)
    return candidates.take(np.argsort(candidates.distances, kind="stable"))


def _nearest_entries(
    index: PoseIndex, vectors: NDArray[np.float32], k: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Rows of the ``k`` entries nearest to each of several descriptors ``(Q, D)`` in one search.

    Also returns whether each was found as its mirror image, and the descriptor that it is near.
    """
    variants = np.stack([vectors, index.descriptor.mirror(vectors)], axis=1)
    entry_ids, nearest_variant = index.search(variants, k)
    rows = np.arange(len(vectors)).repeat(entry_ids.shape[1])
    return entry_ids.ravel(), nearest_variant.ravel() == 1, rows


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
