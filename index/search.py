"""Exact nearest-neighbour search: by descriptor, and by landmarks in three dimensions.

A silhouette does not show what lies inside its outline, and landmarks do not show the outline: each
search finds entries that the other misses.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, Protocol

# With several OpenMP threads FAISS answers a single query more slowly and less exactly.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import faiss
import numpy as np
from numpy.typing import NDArray

from index.skeleton import LIMBS, POINT_NAMES

STEPS = np.float32(8)
"""Values of descriptors are multiples of 1/8, far below what noise does to them: files compress to
a quarter, and a byte holds each value exactly."""

BYTES = faiss.ScalarQuantizer.QT_8bit_direct_signed
"""FAISS's code for whole numbers from -128 to 127, which holds them exactly."""

_LARGEST_STEP = 127

_BLOCK = 65_536
"""Vectors converted at a time: all of a large index would take gigabytes."""


FailureReason = Literal["deadline", "unreachable", "refused"]
"""Why a search by another server failed: too slow, not there, or answered with an error."""


class UnavailableError(Exception):
    """A search by another server failed, though it may succeed later.

    Parameters
    ----------
    message : str
        One sentence for the operator.
    reason : FailureReason
    """

    def __init__(self, message: str, reason: FailureReason) -> None:
        super().__init__(message)
        self.reason: FailureReason = reason


class Neighbours(Protocol):
    """A search for the nearest of a fixed set of vectors; safe under several threads."""

    def __len__(self) -> int:
        """Count the vectors."""

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
            Squared Euclidean distances, ascending, as exact as the search: queries may be rounded
            to the steps of the vectors.
        numbers : (Q, k) int64 array

        Raises
        ------
        UnavailableError
            If the search is done by a server that does not answer.
        """


class ExactNeighbours:
    """Compares each query with all vectors, in this process.

    Parameters
    ----------
    vectors : (E, D) float array
    """

    def __init__(self, vectors: NDArray[np.floating]) -> None:
        dimension = vectors.shape[1]
        self._factor = scale_factor(vectors)
        self._faiss: Any
        if self._factor == STEPS:
            # As exact as floats, in half the time.
            self._faiss = faiss.IndexScalarQuantizer(dimension, BYTES, faiss.METRIC_L2)
        else:
            self._faiss = faiss.IndexFlatL2(dimension)
        for block in _blocks(vectors):
            self._faiss.add(block * self._factor)

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Find the ``k`` vectors nearest to each query; see :meth:`Neighbours.search`.

        Among vectors that are bytes, queries are rounded to steps as well: some versions of FAISS
        drop what follows the point, and take a number beyond a byte's range for one from its other
        end.
        """
        scaled = np.ascontiguousarray(queries * self._factor, np.float32)
        if self._factor == STEPS:
            scaled = np.rint(scaled).clip(-_LARGEST_STEP, _LARGEST_STEP)
        squared, numbers = self._faiss.search(scaled, k)
        return squared / self._factor**2, numbers


def scale_factor(vectors: NDArray[np.floating]) -> np.float32:
    """The factor by which FAISS is given vectors ``(E, D)``.

    :data:`STEPS` where that makes every value a whole number that a byte holds, else 1.
    """
    for block in _blocks(vectors):
        steps = block * STEPS
        if np.abs(steps).max() > _LARGEST_STEP or not np.array_equal(steps, np.rint(steps)):
            return np.float32(1)
    return STEPS


def _blocks(vectors: NDArray[np.floating]) -> Iterator[NDArray[np.float32]]:
    for start in range(0, len(vectors), _BLOCK):
        yield np.ascontiguousarray(vectors[start : start + _BLOCK], np.float32)


SEARCHED = tuple(POINT_NAMES.index(name) for name in LIMBS)
"""Rows of ``POINT_NAMES`` that are compared: shoulders, elbows, wrists, hips, knees, ankles."""

STEPS_PER_BODY = 150.0
"""Coordinates are whole numbers of this part of a body's size, so that a byte holds each: about a
centimetre, far less than landmarks err by."""

DIMENSION = 48
"""Numbers of a vector: three a limb joint, then zeros, since FAISS compares vectors of a multiple
of 16 bytes twelve times faster than others."""
_HIPS = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
_BONES = [
    (LIMBS.index(f"{side}_{start}"), LIMBS.index(f"{side}_{end}"))
    for side in ("left", "right")
    for start, end in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("shoulder", "hip"),
        ("hip", "knee"),
        ("knee", "ankle"),
    )
]
# Shoulder to wrist, shoulder to hip and hip to ankle of a body 1.7 m tall, both sides.
_SIZE_M = 3.6


@dataclass(frozen=True)
class Nearest:
    """Entries nearest to landmarks, nearest first.

    Parameters
    ----------
    numbers : (K,) int64 array
    mirrored : (K,) bool array
        Whether the mirror image of the entry was found.
    roll_deg : (K,) float64 array
        Clockwise rotation in the picture, of the entry seen by a camera that is not rolled, for
        which it was found.
    distances : (K,) float64 array
        Root mean square joint distance, as a share of the size of a body, ascending.
    """

    numbers: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
    roll_deg: NDArray[np.float64]
    distances: NDArray[np.float64]


class LandmarkSearch:
    """Exhaustive search over skeletons about the hips, all of one size; immutable.

    Parameters
    ----------
    vectors : (E, 48) float32 array
        Of :func:`pose_vectors`, of cameras that are not rolled.
    """

    def __init__(self, vectors: NDArray[np.float32]) -> None:
        if vectors.ndim != 2 or vectors.shape[1] != DIMENSION:
            raise ValueError(f"expected vectors of shape (E, {DIMENSION}), got {vectors.shape}")
        self._faiss = faiss.IndexScalarQuantizer(
            vectors.shape[1], faiss.ScalarQuantizer.QT_8bit_direct_signed, faiss.METRIC_L2
        )
        self._faiss.add(np.ascontiguousarray(vectors, np.float32))

    def __len__(self) -> int:
        return int(self._faiss.ntotal)

    def nearest(
        self, points_3d: NDArray[np.float64], rolls_deg: tuple[float, ...], k: int
    ) -> Nearest:
        """Find the ``k`` nearest among all entries and their mirror images.

        Parameters
        ----------
        points_3d : (12, 3) float64 array
            Camera axes, of any origin and unit; rows are ``LIMBS``.
        rolls_deg : tuple of float
            Clockwise rotations in the picture that the person may have.
        k : int
        """
        queries = []
        for roll_deg in rolls_deg:
            turned = rotate_clockwise(points_3d, -roll_deg)
            queries += [turned, mirrored_limbs(turned)]
        k = min(k, len(self))
        squared, numbers = self._faiss.search(pose_vectors(np.stack(queries)), k)
        variants = np.repeat(np.arange(len(queries)), k)
        squared, numbers = squared.ravel(), numbers.ravel()
        order = np.lexsort((numbers, variants, squared))[:k]
        variants = variants[order]
        return Nearest(
            numbers[order],
            variants % 2 == 1,
            np.array(rolls_deg)[variants // 2],
            np.sqrt(np.maximum(squared[order].astype(np.float64), 0) / len(SEARCHED))
            / STEPS_PER_BODY,
        )


def pose_vectors(points_3d: NDArray[np.floating]) -> NDArray[np.float32]:
    """Skeletons ``(N, 12, 3)`` as vectors ``(N, 48)`` of whole numbers, about the hips."""
    points = points_3d - points_3d[:, _HIPS].mean(axis=1, keepdims=True)
    size = body_sizes(points_3d)[:, None, None]
    steps = np.rint(points * (STEPS_PER_BODY / size))
    vectors = np.zeros((len(points), DIMENSION), np.float32)
    flat = np.clip(steps, -_LARGEST_STEP, _LARGEST_STEP).reshape(len(points), -1)
    vectors[:, : flat.shape[1]] = flat
    return vectors


def body_sizes(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Sizes ``(N,)`` of bodies with limbs ``(N, 12, 3)``: about their heights."""
    lengths = sum(
        np.linalg.norm(points_3d[:, start] - points_3d[:, end], axis=-1) for start, end in _BONES
    )
    return np.asarray(np.maximum(lengths, 1e-6) * (1.7 / _SIZE_M), np.float64)


def mirrored_limbs(points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mirror image of limbs ``(12, 3)`` in camera axes."""
    mirrored = points_3d[_OTHER_SIDE].copy()
    mirrored[:, 0] *= -1
    return mirrored


def rotate_clockwise(points_3d: NDArray[np.float64], angle_deg: float) -> NDArray[np.float64]:
    """Rotate points ``(..., 3)`` in camera axes about the optical axis, clockwise as seen."""
    angle = np.deg2rad(angle_deg)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    return np.asarray(points_3d @ rotation)


_OTHER_SIDE = [
    LIMBS.index(
        name.replace("left", "right") if name.startswith("left") else name.replace("right", "left")
    )
    for name in LIMBS
]
