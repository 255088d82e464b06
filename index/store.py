"""The index in memory: entries, their skeletons and silhouettes, and the search; immutable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor
from index import DEFAULT_PATH as DEFAULT_PATH
from index.confidence import Calibration
from index.reranker import RankingModel
from index.search import (
    DIMENSION,
    SEARCHED,
    ExactNeighbours,
    LandmarkSearch,
    Neighbours,
    pose_vectors,
)
from index.silhouettes import Silhouettes
from index.skeleton import POINTS, camera_rotation, mirror_3d, mirror_normalised, project

SKELETON_DTYPE = np.dtype(
    [("clip", "<u2"), ("frame", "<u4"), ("subject", "<u2"), ("action", "<u2"), ("speed", "<f2")]
)
ENTRY_DTYPE = np.dtype(
    [
        ("skeleton", "<u4"),
        ("azimuth_deg", "<f4"),
        ("elevation_deg", "<f4"),
        ("roll_deg", "<f4"),
        ("distance", "<f4"),
        ("scale", "<f4"),
        ("offset_x", "<f4"),
        ("offset_y", "<f4"),
    ]
)

_BLOCK = 8192


def _compact(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    """The same vectors in half precision where that holds them exactly."""
    half = vectors.astype(np.float16)
    return half if np.array_equal(half, vectors) else vectors.astype(np.float32)


@dataclass(frozen=True)
class Label:
    """Where an entry comes from: motion, avatar and camera.

    Parameters
    ----------
    number : int
        Row of the index.
    action, clip, subject : str
        Label of the motion, name of the motion capture clip, name of the avatar.
    frame : int
        Frame of the BVH file, zero-based.
    mirrored : bool
        Whether left and right are exchanged, in the pose and in the camera: each entry also
        stands for its mirror image.
    azimuth_deg, elevation_deg, roll_deg : float
        Camera, as in :func:`index.skeleton.camera_rotation`.
    distance_m : float
        From the camera to the pelvis.
    """

    number: int
    action: str
    clip: str
    subject: str
    frame: int
    mirrored: bool
    azimuth_deg: float
    elevation_deg: float
    roll_deg: float
    distance_m: float


@dataclass(frozen=True)
class Entry(Label):
    """A label and the skeleton.

    Parameters
    ----------
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    points_normalised : (24, 2) float64 array
        Pixels of the normalised frame.
    """

    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]


@dataclass(frozen=True)
class PoseIndex:
    """Simulated silhouettes with their skeletons, searchable by descriptor.

    Parameters
    ----------
    name : str
    descriptor : Descriptor
        The descriptor of the vectors, and of queries.
    vectors : (E, D) float array
    entries : (E,) array of ENTRY_DTYPE
        Skeleton, camera, and placement in the normalised frame. Entries wider than high are seen by
        a camera rolled so that they stand.
    skeletons : (S, 24, 3) float16 array
        Body axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    skeleton_labels : (S,) array of SKELETON_DTYPE
        Origin of each skeleton; clip, subject and action are positions in the next three.
    clips, subjects, actions : tuple of str
    silhouette_store : Silhouettes
        Compressed silhouettes of the entries.
    parameters : dict
        JSON values: the settings of the build, and what was fitted in it.
    version : str
        ``sha256:`` and the hash of the content; empty unless the index was loaded.
    reranker : RankingModel, optional
        Re-ranks the hypotheses of silhouettes.
    searched_by : Neighbours, optional
        Searches ``vectors``; by default exactly, in this process.
    """

    name: str
    descriptor: Descriptor
    vectors: NDArray[np.floating]
    entries: NDArray[np.void]
    skeletons: NDArray[np.float16]
    skeleton_labels: NDArray[np.void]
    clips: tuple[str, ...]
    subjects: tuple[str, ...]
    actions: tuple[str, ...]
    silhouette_store: Silhouettes
    parameters: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    reranker: RankingModel | None = None
    searched_by: InitVar[Neighbours | None] = None
    neighbours: Neighbours = field(init=False, repr=False, compare=False)
    """The search among ``vectors``."""
    landmark_search: LandmarkSearch = field(init=False, repr=False, compare=False)
    """Search for entries by landmarks in three dimensions."""

    def __post_init__(self, searched_by: Neighbours | None) -> None:
        count = len(self.entries)
        expected = (count, self.descriptor.dimension)
        if count == 0:
            raise ValueError("expected an index with at least one entry, got none")
        if self.vectors.shape != expected:
            raise ValueError(f"expected vectors of shape {expected}, got {self.vectors.shape}")
        if self.skeletons.shape != (len(self.skeleton_labels), POINTS, 3):
            raise ValueError(
                f"expected skeletons of shape ({len(self.skeleton_labels)}, {POINTS}, 3), "
                f"got {self.skeletons.shape}"
            )
        if len(self.silhouette_store) != count:
            raise ValueError(f"expected {count} silhouettes, got {len(self.silhouette_store)}")
        if self.entries["skeleton"].max() >= len(self.skeletons):
            raise ValueError(
                f"expected skeletons below {len(self.skeletons)}, an entry names "
                f"{self.entries['skeleton'].max()}"
            )
        neighbours = ExactNeighbours(self.vectors) if searched_by is None else searched_by
        if len(neighbours) != count:
            raise ValueError(f"expected a search of {count} vectors, got one of {len(neighbours)}")
        object.__setattr__(self, "neighbours", neighbours)
        object.__setattr__(self, "vectors", _compact(self.vectors))
        object.__setattr__(self, "landmark_search", LandmarkSearch(self._pose_vectors()))

    def __len__(self) -> int:
        return len(self.entries)

    def calibration(self, *, reranked: bool) -> Calibration:
        """The confidence of hypotheses of a silhouette, re-ranked by the network or not."""
        if reranked and self.reranker is not None:
            return self.reranker.calibration
        return Calibration.restore(self.parameters["confidence"])

    def search(
        self, vectors: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
        """The ``k`` nearest entries to any variant of each query, as :attr:`neighbours` finds them.

        Parameters
        ----------
        vectors : (B, V, D) float32 array
            ``V`` variants of each query; an entry may be found for several of them.
        k : int
            At least 1; K is at most ``V * E``.

        Returns
        -------
        distances : (B, K) float32 array
            Euclidean, ascending.
        numbers : (B, K) int64 array
        variants : (B, K) int64 array
            The variant each was found for.
        """
        queries, variants, dimension = vectors.shape
        flat = np.ascontiguousarray(vectors, np.float32).reshape(-1, dimension)
        squared, numbers = self.neighbours.search(flat, min(k, len(self)))
        squared, numbers = squared.reshape(queries, -1), numbers.reshape(queries, -1)
        variant = np.arange(variants).repeat(numbers.shape[1] // variants)
        variant = np.broadcast_to(variant, numbers.shape)
        # Equal distances: the first variant first, then the first entry.
        order = np.lexsort((numbers, variant, squared))[:, :k]
        distances, numbers, variant = (
            np.take_along_axis(array, order, axis=1)
            for array in (np.sqrt(np.maximum(squared, 0)), numbers, variant)
        )
        return distances, numbers, variant

    def roll_deg(
        self, numbers: NDArray[np.integer], mirrored: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Roll ``(B,)`` of the cameras of entries, or of their mirror images."""
        roll_deg = self.entries["roll_deg"][numbers].astype(np.float64)
        return np.asarray(np.where(mirrored, -roll_deg, roll_deg))

    def points(
        self, numbers: NDArray[np.integer], rows: Sequence[int] | slice = slice(None)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Skeletons of the given entries.

        Parameters
        ----------
        numbers : (B,) int array
        rows : sequence of int, optional
            Rows of ``POINT_NAMES``; by default all 24.

        Returns
        -------
        points_3d : (B, P, 3) float64 array
            Camera axes, metres, pelvis at the origin.
        points_normalised : (B, P, 2) float64 array
            Pixels of the normalised frame.
        """
        entries = self.entries[numbers]
        rotations = camera_rotation(
            entries["azimuth_deg"], entries["elevation_deg"], entries["roll_deg"]
        )
        body = self.skeletons[entries["skeleton"]][:, rows].astype(np.float64)
        # Contiguous matrices are multiplied three times faster.
        points_3d = body @ np.ascontiguousarray(rotations.swapaxes(1, 2))
        points_normalised = project(points_3d, entries["distance"])
        points_normalised *= entries["scale"][:, None, None]
        for axis, offset in enumerate(("offset_x", "offset_y")):
            points_normalised[..., axis] += entries[offset][:, None]
        return points_3d, points_normalised

    def _pose_vectors(self) -> NDArray[np.float32]:
        """Vectors ``(E, 48)`` of all entries for the search by landmarks, cameras upright."""
        vectors = np.empty((len(self), DIMENSION), np.float32)
        # In blocks, because all points of a large index would take gigabytes.
        for start in range(0, len(self), _BLOCK):
            entries = self.entries[start : start + _BLOCK]
            rotations = camera_rotation(entries["azimuth_deg"], entries["elevation_deg"])
            body = self.skeletons[entries["skeleton"]][:, SEARCHED].astype(np.float32)
            turned = body @ np.ascontiguousarray(rotations.swapaxes(1, 2).astype(np.float32))
            vectors[start : start + len(entries)] = pose_vectors(turned)
        return vectors

    def entry(self, number: int, *, mirrored: bool = False) -> Entry:
        """An entry, or its mirror image; raises as :meth:`label` does."""
        label = self.label(number, mirrored=mirrored)
        points_3d, points_normalised = (points[0] for points in self.points(np.array([number])))
        if mirrored:
            points_3d, points_normalised = (
                mirror_3d(points_3d),
                mirror_normalised(points_normalised),
            )
        return Entry(**vars(label), points_3d=points_3d, points_normalised=points_normalised)

    def label(self, number: int, *, mirrored: bool = False) -> Label:
        """The label of an entry, or of its mirror image.

        Raises
        ------
        IndexError
            If there is no such entry.
        """
        if not 0 <= number < len(self):
            raise IndexError(f"expected an entry from 0 to {len(self) - 1}, got {number}")
        # As a tuple: reading a row field by field takes three times as long.
        row = self.entries[number].item()
        skeleton, azimuth_deg, elevation_deg, roll_deg, distance_m, *_ = row
        clip, frame, subject, action, _ = self.skeleton_labels[skeleton].item()
        side = -1.0 if mirrored else 1.0
        return Label(
            number=number,
            action=self.actions[action],
            clip=self.clips[clip],
            subject=self.subjects[subject],
            frame=frame,
            mirrored=mirrored,
            # Twice, because a tiny negative angle rounds to 360 the first time.
            azimuth_deg=side * azimuth_deg % 360.0 % 360.0,
            elevation_deg=elevation_deg,
            roll_deg=side * roll_deg,
            distance_m=distance_m,
        )

    def silhouettes(self, numbers: Sequence[int] | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Normalised silhouettes of the given entries, ``(B, 128, 48)`` uint8 of 0 and 1."""
        return self.silhouette_store.take(numbers)

    def silhouette(self, number: int) -> NDArray[np.uint8]:
        """The normalised silhouette of an entry, ``(128, 48)`` uint8 of 0 and 1."""
        return np.asarray(self.silhouettes([number])[0])
