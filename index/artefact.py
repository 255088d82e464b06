"""The index artefact: a folder, verified when it is read; :mod:`index.build.writer` writes it."""

from __future__ import annotations

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import faiss
import numpy as np

from descriptor.descriptor import restore
from index.files import ArtefactError, read_array, read_bytes
from index.reranker import RankingModel, load_reranker
from index.search import Neighbours
from index.silhouettes import Silhouettes
from index.skeleton import NATIVE
from index.store import PoseIndex

FORMAT_VERSION = 4
MANIFEST = "manifest.json"

SILHOUETTES = "silhouettes.npy"
"""This file is stored as it is, since its content is compressed; all other files are compressed."""


def load_index(
    path: Path, searched_by: Neighbours | None = None, *, reranked: bool = True
) -> PoseIndex:
    """Read and verify an index.

    Parameters
    ----------
    path : Path
        Folder of the artefact.
    searched_by : Neighbours, optional
        Search over its vectors; by default exact, in this process.
    reranked : bool
        Whether to read the network beside it, if there is one.

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
        return _restore(manifest, files, searched_by, reranker)
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
                read_array if name.endswith(".npy") else read_bytes,
                path / stored_name(name),
                expected,
            )
            for name, expected in sha256.items()
        }
        return {name: future.result() for name, future in read.items()}


def _restore(
    manifest: dict[str, Any],
    files: dict[str, Any],
    searched_by: Neighbours | None,
    reranker: RankingModel | None,
) -> PoseIndex:
    learned = {
        name.removeprefix("descriptor-"): array
        for name, array in files.items()
        if name.startswith("descriptor-")
    }
    flat = faiss.deserialize_index(np.frombuffer(files["descriptors.faiss"], np.uint8))
    if type(flat) is not faiss.IndexFlatL2:
        raise ValueError(f"expected a FAISS IndexFlatL2, got {type(flat).__name__}")
    vectors = faiss.rev_swig_ptr(flat.get_xb(), flat.ntotal * flat.d).reshape(flat.ntotal, flat.d)
    return PoseIndex(
        name=manifest["name"],
        descriptor=restore(manifest["descriptor"], learned),
        vectors=vectors,
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


def stored_name(name: str) -> str:
    """Name on disk of a file of the manifest."""
    return name if name == SILHOUETTES else f"{name}.xz"


def version_of(manifest: dict[str, Any]) -> str:
    """Hash of the manifest, which itself holds the hash of every file."""
    content = {key: value for key, value in manifest.items() if key != "version"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
