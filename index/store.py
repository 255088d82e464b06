"""The index in memory: entries, their skeletons and silhouettes, and the search; immutable."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from copy import copy
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor
from descriptor.silhouette import HEIGHT, WIDTH
from index.confidence import Calibration
from index.network import RankingModel
from index.search import ExactNeighbours, Neighbours
from index.skeleton import POINTS, camera_rotation, project

PACKED_BYTES = HEIGHT * WIDTH // 8

RAW_DEFLATE = -15
"""Selects neither header nor checksum, since the artefact has its own."""


@dataclass(frozen=True)
class Silhouettes:
    """Normalised silhouettes, deflated separately with a shared dictionary.

    They take a sixth of their packed size; decompressing one takes microseconds.
    """

    data: NDArray[np.uint8]  # (B,): the deflated silhouettes, concatenated
    ends: NDArray[np.int64]  # (E,): end of each silhouette in ``data``; ascending, the last is B
    dictionary: NDArray[np.uint8]  # (D,)
    step: int = 1  # pixels of the normalised frame for each stored pixel, along both axes: 1 or 2

    def __post_init__(self) -> None:
        if self.step not in (1, 2):
            raise ValueError(
                f"expected silhouettes stored at every or every second pixel, "
                f"got a step of {self.step!r}"
            )
        for name, kind in (("data", np.uint8), ("ends", np.int64), ("dictionary", np.uint8)):
            array = getattr(self, name)
            if array.ndim != 1 or array.dtype != kind:
                raise ValueError(
                    f"expected {name} of silhouettes as a row of {np.dtype(kind)}, "
                    f"got {array.dtype} of shape {array.shape}"
                )
        if len(self.ends) == 0 or (np.diff(self.ends, prepend=0) <= 0).any():
            raise ValueError("expected ascending ends of silhouettes")
        if self.ends[-1] != len(self.data):
            raise ValueError(f"expected {self.ends[-1]} bytes of silhouettes, got {len(self.data)}")

    def select(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Silhouettes:
        starts = np.concatenate([[0], self.ends[:-1]])[rows]
        ends = self.ends[rows]
        spans = zip(starts.tolist(), ends.tolist(), strict=True)
        data = np.concatenate([self.data[:0], *(self.data[start:end] for start, end in spans)])
        return replace(self, data=data, ends=np.cumsum(ends - starts, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.ends)

    def take(self, numbers: Sequence[int] | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Decompress silhouettes: ``(B, 128, 48)`` uint8 of 0 and 1.

        Raises
        ------
        IndexError
            If there is no such silhouette.
        """
        dictionary, size = self.dictionary.tobytes(), PACKED_BYTES // self.step**2
        columns = np.empty((len(numbers), size), np.uint8)
        for row, number in zip(columns, numbers, strict=True):
            if not 0 <= number < len(self):
                raise IndexError(f"expected a silhouette below {len(self)}, got {number}")
            start = self.ends[number - 1] if number else 0
            unpacker = zlib.decompressobj(RAW_DEFLATE, zdict=dictionary)
            row[:] = np.frombuffer(
                unpacker.decompress(self.data[start : self.ends[number]].tobytes(), size), np.uint8
            )
        return _from_columns(columns, self.step)


def _from_columns(columns: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Unpack silhouettes stored by columns of bytes, and enlarge to ``(B, 128, 48)``."""
    packed = columns.reshape(len(columns), WIDTH // 8 // step, HEIGHT // step).swapaxes(1, 2)
    silhouettes = np.unpackbits(packed, axis=2)
    return silhouettes if step == 1 else _double(silhouettes)


def _double(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Enlarge silhouettes ``(B, H, W)`` to twice the size by Scale2x [1]_, which smooths stairs.

    Each quarter of a pixel takes the value of its two neighbours if they agree and differ from the
    opposite two.

    References
    ----------
    .. [1] A. Mazzoleni, "Scale2x", 2001; https://www.scale2x.it/algorithm
    """
    around = np.pad(silhouettes, ((0, 0), (1, 1), (1, 1)), mode="edge")
    above, below = around[:, :-2, 1:-1], around[:, 2:, 1:-1]
    left, right = around[:, 1:-1, :-2], around[:, 1:-1, 2:]
    count, height, width = silhouettes.shape
    doubled = np.empty((count, 2 * height, 2 * width), np.uint8)
    for row, near, far in ((0, above, below), (1, below, above)):
        for column, beside, opposite in ((0, left, right), (1, right, left)):
            corner = (near == beside) & (near != far) & (beside != opposite)
            doubled[:, row::2, column::2] = np.where(corner, near, silhouettes)
    return doubled


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


@dataclass(frozen=True)
class Label:
    """The source of an entry: motion, avatar and camera.

    The action labels the motion, ``frame`` is that of the BVH file of the clip, from 0, the subject
    is the avatar. ``mirrored``: each entry also represents its mirror image, in pose and camera.
    The camera's direction is as in :func:`index.skeleton.camera_rotation`; its distance is to the
    pelvis.
    """

    entry_id: int
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
    """An entry's label and its skeleton.

    ``points_3d`` ``(24, 3)`` are metres about the pelvis in camera axes, ``points_normalised``
    ``(24, 2)`` pixels of the normalised frame.
    """

    points_3d: NDArray[np.float64]
    points_normalised: NDArray[np.float64]


@dataclass(frozen=True)
class PoseIndex:
    """Simulated silhouettes with their skeletons, searchable by descriptor."""

    name: str
    descriptor: Descriptor  # the descriptor of the vectors, and of queries
    vectors: ExactNeighbours  # the descriptors of the entries
    # (E,): skeleton, camera, and placement in the normalised frame. The camera of an entry wider
    # than high is rolled so that the silhouette stands upright.
    entries: NDArray[np.void]
    # (S, 24, 3): body axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    skeletons: NDArray[np.float16]
    # (S,): source of each skeleton; clip, subject and action are positions in the tuples below.
    skeleton_labels: NDArray[np.void]
    clips: tuple[str, ...]
    subjects: tuple[str, ...]
    actions: tuple[str, ...]
    silhouette_store: Silhouettes  # compressed silhouettes of the entries
    # JSON values: the settings of the build and what it fitted.
    parameters: dict[str, Any] = field(default_factory=dict)
    # ``sha256:`` and the hash of the content; empty unless the index was loaded from files.
    version: str = ""
    reranker: RankingModel | None = None  # the network that ranks the hypotheses of silhouettes
    # Search over ``vectors``; by default exact, in this process.
    searched_by: InitVar[Neighbours | None] = None
    neighbours: Neighbours = field(init=False, repr=False, compare=False)
    """Search over ``vectors``."""

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
        neighbours = self.vectors if searched_by is None else searched_by
        if len(neighbours) != count:
            raise ValueError(f"expected a search of {count} vectors, got one of {len(neighbours)}")
        object.__setattr__(self, "neighbours", neighbours)

    def __len__(self) -> int:
        return len(self.entries)

    @cached_property
    def exact(self) -> PoseIndex:
        """The same index, searched by FAISS's ``IndexFlatL2`` with queries that are not rounded.

        Its vectors are made on first use: 38 MB for 198,000 entries, unless they are not bytes.
        """
        if self.neighbours is self.vectors and not self.vectors.rounds_queries:
            return self
        exact = copy(self)
        flat = ExactNeighbours(self.vectors[:], in_bytes=False)
        object.__setattr__(exact, "vectors", flat)
        object.__setattr__(exact, "neighbours", flat)
        return exact

    @property
    def calibration(self) -> Calibration:
        return Calibration.restore(self.parameters["confidence"])

    def search(
        self, vectors: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the ``k`` entries nearest to any of ``V`` variants of each query ``(B, V, D)``.

        Returns entries, nearest first, and the variant for which each was found, ``(B, K)`` both; K
        is at most ``V * E``, since an entry may be found for several variants.
        """
        queries, variants, dimension = vectors.shape
        # Rounded here, so that a server finds the same as this process.
        flat = self.vectors.rounded(
            np.ascontiguousarray(vectors, np.float32).reshape(-1, dimension)
        )
        squared, entry_ids = self.neighbours.search(flat, min(k, len(self)))
        squared, entry_ids = squared.reshape(queries, -1), entry_ids.reshape(queries, -1)
        variant = np.arange(variants).repeat(entry_ids.shape[1] // variants)
        variant = np.broadcast_to(variant, entry_ids.shape)
        # Among equal distances, earlier variants come first, then earlier entries.
        order = np.lexsort((entry_ids, variant, squared))[:, :k]
        return (
            np.take_along_axis(entry_ids, order, axis=1),
            np.take_along_axis(variant, order, axis=1),
        )

    def roll_deg(
        self, entry_ids: NDArray[np.integer], mirrored: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Roll ``(B,)`` of the cameras of entries, or of their mirror images."""
        roll_deg = self.entries["roll_deg"][entry_ids].astype(np.float64)
        return np.where(mirrored, -roll_deg, roll_deg)

    def points(
        self, entry_ids: NDArray[np.integer]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Skeletons of entries: ``(B, P, 3)`` metres in camera axes about the pelvis, and pixels.

        The latter, ``(B, P, 2)``, are of the normalised frame.
        """
        entries = self.entries[entry_ids]
        rotations = camera_rotation(
            entries["azimuth_deg"], entries["elevation_deg"], entries["roll_deg"]
        )
        body = self.skeletons[entries["skeleton"]].astype(np.float64)
        # Contiguous matrices are multiplied three times faster.
        points_3d = body @ np.ascontiguousarray(rotations.swapaxes(1, 2))
        points_normalised = project(points_3d, entries["distance"])
        points_normalised *= entries["scale"][:, None, None]
        for axis, offset in enumerate(("offset_x", "offset_y")):
            points_normalised[..., axis] += entries[offset][:, None]
        return points_3d, points_normalised

    def entry(self, entry_id: int) -> Entry:
        label = self.label(entry_id)
        points_3d, points_normalised = (points[0] for points in self.points(np.array([entry_id])))
        return Entry(**vars(label), points_3d=points_3d, points_normalised=points_normalised)

    def label(self, entry_id: int, *, mirrored: bool = False) -> Label:
        """The label of an entry, or of its mirror image.

        Raises
        ------
        IndexError
            If there is no such entry.
        """
        if not 0 <= entry_id < len(self):
            raise IndexError(f"expected an entry from 0 to {len(self) - 1}, got {entry_id}")
        # The row is read as a tuple: reading it field by field takes three times as long.
        row = self.entries[entry_id].item()
        skeleton, azimuth_deg, elevation_deg, roll_deg, distance_m, *_ = row
        clip, frame, subject, action, _ = self.skeleton_labels[skeleton].item()
        side = -1.0 if mirrored else 1.0
        return Label(
            entry_id=entry_id,
            action=self.actions[action],
            clip=self.clips[clip],
            subject=self.subjects[subject],
            frame=frame,
            mirrored=mirrored,
            # The remainder is taken twice, because a tiny negative angle first gives 360.
            azimuth_deg=side * azimuth_deg % 360.0 % 360.0,
            elevation_deg=elevation_deg,
            roll_deg=side * roll_deg,
            distance_m=distance_m,
        )

    def silhouettes(self, entry_ids: Sequence[int] | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Normalised silhouettes of the given entries, ``(B, 128, 48)`` uint8 of 0 and 1."""
        return self.silhouette_store.take(entry_ids)

    def silhouette(self, entry_id: int) -> NDArray[np.uint8]:
        """The normalised silhouette of an entry, ``(128, 48)`` uint8 of 0 and 1."""
        return self.silhouettes([entry_id])[0]
