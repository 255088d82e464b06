"""The index artefact: a folder that is written whole or not at all, and verified when read."""

from __future__ import annotations

import hashlib
import json
import lzma
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import faiss
import numpy as np

from descriptor.descriptor import restore
from index.files import ArtefactError, npy_bytes, read_array, read_bytes, replacing
from index.reranker import FILES as RERANKER_FILES
from index.reranker import RankingModel, load_reranker, reranker_files
from index.search import Neighbours
from index.silhouettes import Silhouettes
from index.skeleton import NATIVE
from index.store import PoseIndex

FORMAT_VERSION = 4
MANIFEST = "manifest.json"

_SILHOUETTES = "silhouettes.npy"
"""This file is stored as it is, since its content is compressed; all other files are compressed."""

_LZMA = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "pb": 0}]
"""Without context for literals (``lc``, ``pb``), decompression is a third faster, for 1 % more
bytes."""


def save_index(index: PoseIndex, path: Path) -> str:
    """Write an index as a folder, whole or not at all, and return its version.

    A network that re-ranks is written beside it and does not affect the version.

    Raises
    ------
    ArtefactError
        If ``path`` holds anything but an index; see :func:`check_replaceable`.
    """
    path = Path(path).resolve()
    check_replaceable(path)
    files = _files(index)
    manifest: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "name": index.name,
        "entries": len(index),
        "joints": list(NATIVE.names),
        "descriptor": {**index.descriptor.parameters(), "dimension": index.descriptor.dimension},
        "clips": list(index.clips),
        "subjects": list(index.subjects),
        "actions": list(index.actions),
        "silhouette_step": index.silhouette_store.step,
        "parameters": index.parameters,
        "files": {
            name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())
        },
    }
    stored = {
        _stored_name(name): content
        if name == _SILHOUETTES
        else lzma.compress(content, filters=_LZMA)
        for name, content in files.items()
    }
    if index.reranker is not None:
        stored |= reranker_files(index.reranker)
    return _write(path, manifest, stored)


def _write(path: Path, manifest: dict[str, Any], stored: dict[str, bytes]) -> str:
    """Seal a manifest and write the folder; return its version."""
    version = _version(manifest)
    manifest = {**manifest, "version": version}
    with replacing(path) as folder:
        for name, content in stored.items():
            (folder / name).write_bytes(content)
        (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
        # Other files may have appeared since the build began.
        check_replaceable(path)
    return version


def check_replaceable(path: Path) -> None:
    """Refuse to write an index where anything else would be deleted.

    Raises
    ------
    ArtefactError
        Unless ``path`` is missing, is an empty folder, or holds an index of any format and nothing
        else.
    """
    if path.exists() and not path.is_dir():
        raise ArtefactError(f"expected a folder for the index, got the file {path}")
    found = {file.name for file in path.iterdir()} if path.exists() else set()
    foreign = sorted(found - _own_names(path))
    if foreign:
        raise ArtefactError(
            f"expected {path} to be missing, empty or an index, since it is replaced whole; it "
            f"holds {len(foreign)} other file{'s' * (len(foreign) > 1)}, such as {foreign[0]}"
        )


def _own_names(path: Path) -> set[str]:
    """Names of the files of an index of any format; none if there is no index."""
    try:
        manifest = json.loads((path / MANIFEST).read_bytes())
        names = set(manifest["files"])
        is_index = {"format_version", "version", "descriptor"} <= manifest.keys()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()
    if not is_index:
        return set()
    return {MANIFEST, *RERANKER_FILES, *names, *(f"{name}.xz" for name in names)}


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


def _files(index: PoseIndex) -> dict[str, bytes]:
    flat = faiss.IndexFlatL2(index.descriptor.dimension)
    flat.add(index.vectors.astype(np.float32))
    silhouettes = index.silhouette_store
    learned = {f"descriptor-{k}.npy": npy_bytes(v) for k, v in index.descriptor.arrays().items()}
    return {
        "descriptors.faiss": faiss.serialize_index(flat).tobytes(),
        "entries.npy": npy_bytes(index.entries),
        "skeletons.npy": npy_bytes(index.skeletons),
        "skeleton-labels.npy": npy_bytes(index.skeleton_labels),
        _SILHOUETTES: npy_bytes(silhouettes.data),
        "silhouette-lengths.npy": npy_bytes(np.diff(silhouettes.ends, prepend=0).astype("<u2")),
        "silhouette-dictionary.npy": npy_bytes(silhouettes.dictionary),
        **learned,
    }


def _read_files(path: Path, sha256: dict[str, str]) -> dict[str, Any]:
    """Contents of the files of a manifest: arrays, by their names without ``.npy``, or bytes."""
    # Decompressing and hashing release the interpreter's lock.
    with ThreadPoolExecutor() as pool:
        read = {
            name.removesuffix(".npy"): pool.submit(
                read_array if name.endswith(".npy") else read_bytes,
                path / _stored_name(name),
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
    if manifest.get("version") != _version(manifest):
        raise ArtefactError(f"the manifest {file} was altered: its content hash does not fit")
    return cast("dict[str, Any]", manifest)


def _stored_name(name: str) -> str:
    """Name on disk of a file of the manifest."""
    return name if name == _SILHOUETTES else f"{name}.xz"


def _version(manifest: dict[str, Any]) -> str:
    """Hash of the manifest, which itself holds the hash of every file."""
    content = {key: value for key, value in manifest.items() if key != "version"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(canonical.encode()).hexdigest()
