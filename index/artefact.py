"""The index artefact: a folder, verified when it is read; :mod:`scripts.index.writer` writes it.

The folder may also hold a re-ranking network. ``reranking.npz`` holds its weights,
``reranking.json`` their SHA-256 and the constants fitted to it, and ``postures.npz`` the network
that reads postures from its hidden layer. Without it, hypotheses are ordered by distance alone.
"""

import hashlib
import json
import lzma
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import faiss
import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import restore
from index import DEFAULT_PATH
from index.arrays import load_array, load_arrays
from index.confidence import RERANKING_FEATURES, Calibration
from index.network import JointNetwork, PostureNetwork, RankingModel
from index.search import ExactNeighbours, Neighbours
from index.skeleton import NATIVE
from index.store import PoseIndex, Silhouettes

FORMAT_VERSION = 4
MANIFEST = "manifest.json"

SILHOUETTES = "silhouettes.npy"
"""This file is stored as it is, since its content is compressed; all other files are compressed."""

RERANKING_FORMAT_VERSION = 2
RERANKING_JSON, RERANKING_NPZ = "reranking.json", "reranking.npz"
POSTURES_NPZ = "postures.npz"


class ArtefactError(ValueError):
    """An index artefact that cannot be used; the message says why in one sentence."""


def load_index(
    path: Path = DEFAULT_PATH,
    searched_by: Neighbours | None = None,
    *,
    reranked: bool = True,
    in_bytes: bool = True,
) -> PoseIndex:
    """Read and verify an index, and the network beside it if there is one and it is wanted.

    Its vectors are searched by ``searched_by``; by default exactly, in this process. ``in_bytes``
    is that of :class:`index.search.ExactNeighbours`.

    Raises
    ------
    ArtefactError
        If it is missing, truncated, altered, or not an artefact of this format.
    """
    path = Path(path)
    manifest = _read_manifest(path)
    try:
        files = _read_files(path, manifest["files"])
        reranker = load_reranker(path) if reranked else None
        return _restore(manifest, files, searched_by, reranker, in_bytes=in_bytes)
    except ArtefactError:
        raise
    except KeyError as error:
        raise ArtefactError(f"the index at {path} lacks {error}") from error
    except (ValueError, RuntimeError, TypeError, AttributeError) as error:
        raise ArtefactError(f"the index at {path} does not hold together: {error}") from error


def find_artefact(folder: Path, version: str) -> Path:
    """Return the artefact of a version: ``folder`` or one in it; raise :class:`ArtefactError`."""
    for manifest in sorted([*folder.glob(MANIFEST), *folder.glob(f"[!.]*/{MANIFEST}")]):
        with suppress(ArtefactError):
            if _read_manifest(manifest.parent)["version"] == version:
                return manifest.parent
    raise ArtefactError(f"expected an artefact of version {version} in {folder}, found none")


def _read_files(path: Path, sha256: dict[str, str]) -> dict[str, Any]:
    """Contents of the files of a manifest: arrays, by their names without ``.npy``, or bytes."""
    # Decompressing and hashing release the interpreter's lock.
    with ThreadPoolExecutor() as pool:
        read = {
            name.removesuffix(".npy"): pool.submit(
                read_array if name.endswith(".npy") else _read_bytes,
                path / stored_name(name),
                expected,
            )
            for name, expected in sha256.items()
        }
        return {name: future.result() for name, future in read.items()}


def load_reranker(folder: Path) -> RankingModel | None:
    """Read and verify the network beside an index; None if there is none.

    Raises
    ------
    ArtefactError
        If it is incomplete, altered, or not a network of this format.
    """
    file, weights = folder / RERANKING_JSON, folder / RERANKING_NPZ
    if not file.exists():
        if weights.exists():
            raise ArtefactError(f"the network {weights} lacks its manifest {file.name} beside it")
        return None
    try:
        manifest = json.loads(file.read_bytes())
        version = manifest["format_version"]
        if version != RERANKING_FORMAT_VERSION:
            raise ArtefactError(
                f"{file} has format {version}, this service reads format {RERANKING_FORMAT_VERSION}"
            )
        network = JointNetwork.restore(load_arrays(_read_bytes(weights, manifest["sha256"])))
        columns, rows, depths = (float(value) for value in manifest["spread"])
        if not min(columns, rows, depths) >= 0:
            raise ValueError(f"expected a spread of 0 or more, got {manifest['spread']}")
        return RankingModel(
            network,
            Calibration.restore(manifest["confidence"], RERANKING_FEATURES),
            dict(manifest["training"]),
            float(manifest["order_weight"]),
            float(manifest["support_weight"]),
            (columns, rows, depths),
            _load_postures(folder / POSTURES_NPZ, manifest["sha256"]),
        )
    except ArtefactError:
        raise
    except (OSError, KeyError, TypeError, ValueError, BadZipFile) as error:
        raise ArtefactError(f"{file} and {weights.name} do not hold together: {error}") from error


def _load_postures(file: Path, network_sha256: str) -> PostureNetwork | None:
    """Read the posture network beside a re-ranking network; None if there is none."""
    if not file.exists():
        return None
    arrays = load_arrays(file)
    if str(arrays["network_sha256"]) != network_sha256:
        raise ArtefactError(
            f"{file} was trained for another network: `python -m scripts train-silhouette-postures`"
        )
    return PostureNetwork.restore(arrays)


def _restore(
    manifest: dict[str, Any],
    files: dict[str, Any],
    searched_by: Neighbours | None,
    reranker: RankingModel | None,
    *,
    in_bytes: bool,
) -> PoseIndex:
    learned = {
        name.removeprefix("descriptor-"): array
        for name, array in files.items()
        if name.startswith("descriptor-")
    }
    return PoseIndex(
        name=manifest["name"],
        descriptor=restore(manifest["descriptor"], learned),
        vectors=_vectors(files.pop("descriptors.faiss"), in_bytes=in_bytes),  # Frees 38 MB.
        entries=files["entries"],
        skeletons=files["skeletons"],
        skeleton_labels=files["skeleton-labels"],
        clips=tuple(manifest["clips"]),
        subjects=tuple(manifest["subjects"]),
        actions=tuple(manifest["actions"]),
        silhouette_store=Silhouettes(
            files["silhouettes"],
            np.cumsum(files["silhouette-lengths"], dtype=np.int64),
            files["silhouette-dictionary"],
            manifest["silhouette_step"],
        ),
        parameters=manifest["parameters"],
        version=manifest["version"],
        reranker=reranker,
        searched_by=searched_by,
    )


def _vectors(content: bytes, *, in_bytes: bool) -> ExactNeighbours:
    flat = faiss.deserialize_index(np.frombuffer(content, np.uint8))
    if type(flat) is not faiss.IndexFlatL2:
        raise ValueError(f"expected a FAISS IndexFlatL2, got {type(flat).__name__}")
    values = faiss.rev_swig_ptr(flat.get_xb(), flat.ntotal * flat.d)
    return ExactNeighbours(values.reshape(flat.ntotal, flat.d), in_bytes=in_bytes)


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / MANIFEST
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
    if manifest.get("version") != version_of(manifest):
        raise ArtefactError(f"the manifest {file} was altered: its content hash does not fit")
    return cast("dict[str, Any]", manifest)


def read_array(file: Path, sha256: str) -> NDArray[np.generic]:
    """Read an ``.npy`` file, decompressed if its name ends in ``.xz``, and verify it.

    Raises
    ------
    ArtefactError
        If the file is missing, truncated, altered or not an array.
    """
    content = _read_bytes(file, sha256)
    try:
        return load_array(content)
    except (ValueError, EOFError) as error:
        raise ArtefactError(f"{file} is no array: {error}") from error


def _read_bytes(file: Path, sha256: str) -> bytes:
    """Read a file, decompressed if its name ends in ``.xz``, and verify it."""
    try:
        content = file.read_bytes()
        if file.suffix == ".xz":
            content = lzma.decompress(content)
    except OSError as error:
        raise ArtefactError(f"the index file {file} cannot be read: {error.strerror}") from error
    except lzma.LZMAError as error:
        raise ArtefactError(f"the index file {file} is truncated or altered: {error}") from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ArtefactError(f"the index file {file} was altered: its SHA-256 does not fit")
    return content


def stored_name(name: str) -> str:
    return name if name == SILHOUETTES else f"{name}.xz"


def version_of(manifest: dict[str, Any]) -> str:
    """Hash of the manifest, which itself holds the hash of every file."""
    content = {key: value for key, value in manifest.items() if key != "version"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
