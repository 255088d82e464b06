"""PoseIndex: the artefact on disk, verified when loaded, immutable in memory."""

from __future__ import annotations

import hashlib
import json
import lzma
import os
import shutil
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

# FAISS answers a single query slower and inexactly with several OpenMP threads.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import faiss
import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor, restore
from index.artefact import ArtefactError, npy_bytes, read_array, read_bytes
from index.folders import clear_left_overs, lock, replace_folder
from index.keypoint_search import SEARCHED, KeypointSearch
from index.nearest import NearestVectors
from index.silhouettes import Silhouettes
from index.skeleton import (
    NATIVE,
    POINTS,
    camera_rotation,
    mirror_3d,
    mirror_normalised,
    project,
)

FORMAT_VERSION = 2
DEFAULT_PATH = Path(__file__).parent / "data"

SKELETON_DTYPE = np.dtype(
    [("clip", "<u2"), ("frame", "<u4"), ("subject", "<u2"), ("action", "<u2")]
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

_INCOMPRESSIBLE = "silhouettes.npy"
"""Lies in the artefact as it is; every other file is compressed as a whole."""


@dataclass(frozen=True)
class Label:
    """Of one simulated silhouette: whose it is, what it does and who looks at it.

    Parameters
    ----------
    number : int
        Its row in the index.
    action, clip, subject : str
        Label of the motion, name of the motion capture clip, name of the avatar.
    frame : int
        Frame of the clip, zero-based, as the BVH file counts them.
    mirrored : bool
        Whether left and right are exchanged, pose and camera both: an index stores each pose
        once and stands for its mirror image too.
    azimuth_deg, elevation_deg, roll_deg : float
        Camera, as :func:`index.skeleton.camera_rotation` takes them.
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
    """A label with its skeleton.

    Parameters
    ----------
    points_3d : (24, 3) float64 array
        Camera axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    points_normalised : (24, 2) float64 array
        The same in pixels of the normalised silhouette.
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
        What the vectors were described with, and what queries must be.
    vectors : (E, D) float32 array
    entries : (E,) array of ENTRY_DTYPE
        Which skeleton, seen by which camera, placed where in the normalised frame.
    skeletons : (S, 24, 3) float16 array
        Body axes, metres, origin at the pelvis; rows are ``POINT_NAMES``.
    skeleton_labels : (S,) array of SKELETON_DTYPE
        Where each skeleton comes from, as positions in the next three.
    clips, subjects, actions : tuple of str
    silhouette_store : Silhouettes
        E normalised silhouettes, compressed.
    parameters : dict
        JSON values: how the index was built, and what was fitted with it.
    version : str
        ``sha256:`` and the hash of the content; empty until saved or loaded.
    """

    name: str
    descriptor: Descriptor
    vectors: NDArray[np.float32]
    entries: NDArray[np.void]
    skeletons: NDArray[np.float16]
    skeleton_labels: NDArray[np.void]
    clips: tuple[str, ...]
    subjects: tuple[str, ...]
    actions: tuple[str, ...]
    silhouette_store: Silhouettes
    parameters: dict[str, Any] = field(default_factory=dict)
    version: str = ""
    keypoint_search: KeypointSearch = field(init=False, repr=False, compare=False)
    """The entries' projected skeletons, searchable by keypoints."""
    _flat: Any = field(init=False, repr=False, compare=False)
    _nearest: NearestVectors = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
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
        flat = faiss.IndexFlatL2(self.descriptor.dimension)
        flat.add(self.vectors)
        object.__setattr__(self, "_flat", flat)
        object.__setattr__(self, "_nearest", NearestVectors(flat))
        # The vectors live on inside FAISS; one copy is enough.
        view = faiss.rev_swig_ptr(flat.get_xb(), self.vectors.size).reshape(self.vectors.shape)
        object.__setattr__(self, "vectors", view)
        object.__setattr__(self, "keypoint_search", KeypointSearch(self._searched_points()))

    def __len__(self) -> int:
        return len(self.entries)

    def search(
        self, vectors: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
        """The ``k`` nearest entries to any variant of each query, exactly.

        Parameters
        ----------
        vectors : (B, V, D) float32 array
            ``V`` variants of each query; an entry may be near several.
        k : int
            At least 1; no more than ``V`` times all entries are returned.

        Returns
        -------
        distances : (B, K) float32 array
            Euclidean, ascending.
        numbers : (B, K) int64 array
        variants : (B, K) int64 array
            Which variant each is so near to.
        """
        squared, numbers, variants = self._nearest.search(
            np.ascontiguousarray(vectors, np.float32), k
        )
        return np.sqrt(np.maximum(squared, 0)), numbers, variants

    def points(
        self, numbers: NDArray[np.integer], rows: Sequence[int] | slice = slice(None)
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Skeletons of some entries.

        Parameters
        ----------
        numbers : (B,) int array
        rows : sequence of int, optional
            Which of their 24 points; by default all.

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
        # Matrices that lie in one piece are multiplied in a third of the time.
        points_3d = body @ np.ascontiguousarray(rotations.swapaxes(1, 2))
        points_normalised = project(points_3d, entries["distance"])
        points_normalised *= entries["scale"][:, None, None]
        for axis, offset in enumerate(("offset_x", "offset_y")):
            points_normalised[..., axis] += entries[offset][:, None]
        return points_3d, points_normalised

    def _searched_points(self) -> NDArray[np.float32]:
        """What :class:`index.keypoint_search.KeypointSearch` compares, ``(E, 10, 2)``."""
        points = np.empty((len(self), len(SEARCHED), 2), np.float32)
        # In blocks: all points of all entries take gigabytes where an index is large.
        for start in range(0, len(self), _BLOCK):
            rows = np.arange(start, min(start + _BLOCK, len(self)))
            points[rows] = self.points(rows, SEARCHED)[1]
        return points

    def entry(self, number: int, *, mirrored: bool = False) -> Entry:
        """One entry, or its mirror image; raises as :meth:`label` does."""
        label = self.label(number, mirrored=mirrored)
        points_3d, points_normalised = (points[0] for points in self.points(np.array([number])))
        if mirrored:
            points_3d, points_normalised = (
                mirror_3d(points_3d),
                mirror_normalised(points_normalised),
            )
        return Entry(**vars(label), points_3d=points_3d, points_normalised=points_normalised)

    def label(self, number: int, *, mirrored: bool = False) -> Label:
        """Spell out the label of one entry, or of its mirror image.

        Raises
        ------
        IndexError
            Where there is no such entry.
        """
        if not 0 <= number < len(self):
            raise IndexError(f"expected an entry from 0 to {len(self) - 1}, got {number}")
        # As tuples: reading a row field by field takes three times as long.
        row = self.entries[number].item()
        skeleton, azimuth_deg, elevation_deg, roll_deg, distance_m, *_ = row
        clip, frame, subject, action = self.skeleton_labels[skeleton].item()
        side = -1.0 if mirrored else 1.0
        return Label(
            number=number,
            action=self.actions[action],
            clip=self.clips[clip],
            subject=self.subjects[subject],
            frame=frame,
            mirrored=mirrored,
            # Twice: a tiny negative angle becomes 360 itself the first time.
            azimuth_deg=side * azimuth_deg % 360.0 % 360.0,
            elevation_deg=elevation_deg,
            roll_deg=side * roll_deg,
            distance_m=distance_m,
        )

    def silhouettes(self, numbers: Sequence[int] | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Normalised silhouettes of some entries, ``(B, 128, 48)`` uint8 of 0 and 1."""
        return self.silhouette_store.take(numbers)

    def silhouette(self, number: int) -> NDArray[np.uint8]:
        """The normalised silhouette of one entry, ``(128, 48)`` uint8 of 0 and 1."""
        return np.asarray(self.silhouettes([number])[0])

    def save(self, path: Path) -> str:
        """Write the artefact as a folder, whole or not at all; return its version."""
        files = self._files()
        manifest = {
            "format_version": FORMAT_VERSION,
            "name": self.name,
            "entries": len(self),
            "joints": list(NATIVE.names),
            "descriptor": {**self.descriptor.parameters(), "dimension": self.descriptor.dimension},
            "clips": list(self.clips),
            "subjects": list(self.subjects),
            "actions": list(self.actions),
            "parameters": self.parameters,
            "files": {
                name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())
            },
        }
        version = _version(manifest)
        manifest["version"] = version
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_left_overs(path)
        staging = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        held = lock(staging)
        try:
            for name, content in files.items():
                (staging / _stored(name)).write_bytes(
                    content if name == _INCOMPRESSIBLE else lzma.compress(content, preset=6)
                )
            (staging / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
            staging.chmod(0o755)
            replace_folder(staging, path)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
            if held is not None:
                os.close(held)
        return version

    def _files(self) -> dict[str, bytes]:
        learned = {f"descriptor-{k}.npy": npy_bytes(v) for k, v in self.descriptor.arrays().items()}
        return {
            "descriptors.faiss": faiss.serialize_index(self._flat).tobytes(),
            "entries.npy": npy_bytes(self.entries),
            "skeletons.npy": npy_bytes(self.skeletons),
            "skeleton-labels.npy": npy_bytes(self.skeleton_labels),
            _INCOMPRESSIBLE: npy_bytes(self.silhouette_store.data),
            "silhouette-lengths.npy": npy_bytes(
                np.diff(self.silhouette_store.ends, prepend=0).astype("<u2")
            ),
            "silhouette-dictionary.npy": npy_bytes(self.silhouette_store.dictionary),
            **learned,
        }

    @classmethod
    def load(cls, path: Path) -> PoseIndex:
        """Read and verify an artefact.

        Raises
        ------
        ArtefactError
            If it is missing, truncated, altered, or not an artefact of this format.
        """
        path = Path(path)
        manifest = _read_manifest(path)
        try:
            named = dict(manifest["files"])
            # Decompressing and hashing leave Python's lock to each other.
            with ThreadPoolExecutor() as pool:
                read = {
                    name: pool.submit(
                        read_array if name.endswith(".npy") else read_bytes,
                        path / _stored(name),
                        sha256,
                    )
                    for name, sha256 in named.items()
                }
                files = {name: future.result() for name, future in read.items()}
            arrays: dict[str, Any] = {
                name.removesuffix(".npy"): file for name, file in files.items()
            }
            learned = {
                name.removeprefix("descriptor-"): array
                for name, array in arrays.items()
                if name.startswith("descriptor-")
            }
            flat = faiss.deserialize_index(np.asarray(files["descriptors.faiss"], np.uint8))
            if type(flat) is not faiss.IndexFlatL2:
                raise ValueError(f"expected a FAISS IndexFlatL2, got {type(flat).__name__}")
            vectors = faiss.rev_swig_ptr(flat.get_xb(), flat.ntotal * flat.d)
            return cls(
                name=manifest["name"],
                descriptor=restore(manifest["descriptor"], learned),
                vectors=vectors.reshape(flat.ntotal, flat.d),
                entries=arrays["entries"],
                skeletons=arrays["skeletons"],
                skeleton_labels=arrays["skeleton-labels"],
                clips=tuple(manifest["clips"]),
                subjects=tuple(manifest["subjects"]),
                actions=tuple(manifest["actions"]),
                silhouette_store=Silhouettes(
                    arrays["silhouettes"],
                    np.cumsum(arrays["silhouette-lengths"], dtype=np.int64),
                    arrays["silhouette-dictionary"],
                ),
                parameters=manifest["parameters"],
                version=manifest["version"],
            )
        except ArtefactError:
            raise
        except KeyError as error:
            raise ArtefactError(f"the index at {path} lacks {error}") from error
        except (ValueError, RuntimeError, TypeError, AttributeError) as error:
            raise ArtefactError(f"the index at {path} does not hold together: {error}") from error


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / "manifest.json"
    try:
        manifest = json.loads(file.read_bytes())
    except FileNotFoundError:
        raise ArtefactError(f"there is no index at {path}: {file} is missing") from None
    except (OSError, ValueError) as error:
        raise ArtefactError(f"the manifest {file} is unreadable: {error}") from error
    if not isinstance(manifest, dict) or "format_version" not in manifest:
        raise ArtefactError(f"{file} is not the manifest of a pose index")
    if manifest["format_version"] != FORMAT_VERSION:
        raise ArtefactError(
            f"the index at {path} has format {manifest['format_version']}, "
            f"this service reads format {FORMAT_VERSION}"
        )
    if manifest.get("joints") != list(NATIVE.names):
        raise ArtefactError(f"the index at {path} was built for another set of joints")
    if manifest.get("version") != _version(manifest):
        raise ArtefactError(f"the manifest {file} was altered: its content hash does not fit")
    return cast("dict[str, Any]", manifest)


def _stored(name: str) -> str:
    """Name on disk of a file that the manifest names."""
    return name if name == _INCOMPRESSIBLE else f"{name}.xz"


def _version(manifest: dict[str, Any]) -> str:
    """Content hash: of everything in the manifest, which holds the hash of every file's content."""
    content = {key: value for key, value in manifest.items() if key != "version"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
