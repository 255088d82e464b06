"""Writing an index: its silhouettes compressed, its folder whole or not at all."""

import hashlib
import io
import json
import lzma
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import faiss
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import unpack
from index.artefact import (
    FORMAT_VERSION,
    MANIFEST,
    POSTURES_NPZ,
    RERANKING_FORMAT_VERSION,
    RERANKING_JSON,
    RERANKING_NPZ,
    SILHOUETTES,
    ArtefactError,
    stored_name,
    version_of,
)
from index.network import PostureNetwork, RankingModel, halve
from index.skeleton import NATIVE
from index.store import PACKED_BYTES, RAW_DEFLATE, PoseIndex, Silhouettes

# Without context for literals (``lc``, ``pb``), decompression is a third faster, for 1 % more
# bytes.
_LZMA = [{"id": lzma.FILTER_LZMA2, "preset": 6, "lc": 0, "pb": 0}]
# Level of deflate, and distance over which it looks back: a longer dictionary would be useless.
_LEVEL, _WINDOW_BYTES = 6, 32 * 1024
# Silhouettes unpacked at a time.
_BLOCK = 4096


def save_index(index: PoseIndex, path: Path) -> str:
    """Write an index as a folder, whole or not at all, and return its version.

    The re-ranking network is written beside it and does not affect the version.

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
        stored_name(name): content if name == SILHOUETTES else lzma.compress(content, filters=_LZMA)
        for name, content in files.items()
    }
    if index.reranker is not None:
        stored |= _reranker_files(index.reranker)
    return _write(path, manifest, stored)


def _write(path: Path, manifest: dict[str, Any], stored: dict[str, bytes]) -> str:
    """Seal a manifest and write the folder; return its version."""
    version = version_of(manifest)
    manifest = {**manifest, "version": version}
    with _replacing(path) as folder:
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
    beside = {MANIFEST, RERANKING_JSON, RERANKING_NPZ, POSTURES_NPZ}
    return {*beside, *names, *(f"{name}.xz" for name in names)}


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces ``path`` at the end.

    If anything fails, ``path`` stays as it was. A process killed here may leave a hidden folder
    beside ``path``; if it dies between the two renames, the old folder is in there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as staging:
        new, old = Path(staging, "new"), Path(staging, "old")
        new.mkdir()
        yield new
        if path.exists():
            path.rename(old)
        try:
            new.rename(path)
        except OSError:
            if old.exists():
                old.rename(path)
            raise


def _files(index: PoseIndex) -> dict[str, bytes]:
    flat = faiss.IndexFlatL2(index.descriptor.dimension)
    flat.add(index.vectors[:])
    silhouettes = index.silhouette_store
    learned = {f"descriptor-{k}.npy": npy_bytes(v) for k, v in index.descriptor.arrays().items()}
    return {
        "descriptors.faiss": faiss.serialize_index(flat).tobytes(),
        "entries.npy": npy_bytes(index.entries),
        "skeletons.npy": npy_bytes(index.skeletons),
        "skeleton-labels.npy": npy_bytes(index.skeleton_labels),
        SILHOUETTES: npy_bytes(silhouettes.data),
        "silhouette-lengths.npy": npy_bytes(np.diff(silhouettes.ends, prepend=0).astype("<u2")),
        "silhouette-dictionary.npy": npy_bytes(silhouettes.dictionary),
        **learned,
    }


def save_reranker(reranker: RankingModel, folder: Path) -> None:
    """Write the network beside an index without changing the index's own files.

    Postures that were read from an earlier network are deleted.
    """
    (folder / POSTURES_NPZ).unlink(missing_ok=True)
    for name, content in _reranker_files(reranker).items():
        (folder / name).write_bytes(content)


def _reranker_files(reranker: RankingModel) -> dict[str, bytes]:
    """Contents of the files, by name; the same network gives the same bytes."""
    weights = _npz_bytes(reranker.network.arrays())
    sha256 = hashlib.sha256(weights).hexdigest()
    manifest = {
        "format_version": RERANKING_FORMAT_VERSION,
        "sha256": sha256,
        "order_weight": reranker.order_weight,
        "support_weight": reranker.support_weight,
        "spread": list(reranker.spread),
        "confidence": reranker.calibration.parameters(),
        "training": reranker.training,
    }
    files = {
        RERANKING_NPZ: weights,
        RERANKING_JSON: (json.dumps(manifest, indent=1) + "\n").encode(),
    }
    if reranker.postures is not None:
        files[POSTURES_NPZ] = _posture_bytes(reranker.postures, sha256)
    return files


def save_postures(postures: PostureNetwork, folder: Path) -> None:
    """Write the posture network beside the re-ranking network of an index."""
    network = json.loads((folder / RERANKING_JSON).read_bytes())
    (folder / POSTURES_NPZ).write_bytes(_posture_bytes(postures, network["sha256"]))


def _posture_bytes(postures: PostureNetwork, network_sha256: str) -> bytes:
    return _npz_bytes(postures.arrays() | {"network_sha256": np.array(network_sha256)})


def _npz_bytes(arrays: Mapping[str, NDArray[np.generic]]) -> bytes:
    """Serialise arrays as the content of an ``.npz`` file; the same arrays give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            # A separate ZipInfo leaves out the time of writing.
            member = zipfile.ZipInfo(f"{name}.npy")
            archive.writestr(member, npy_bytes(array), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def npy_bytes(array: NDArray[np.generic]) -> bytes:
    """Serialise an array as the content of an ``.npy`` file."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def compress(bits: NDArray[np.uint8]) -> Silhouettes:
    """Compress silhouettes packed by :func:`descriptor.silhouette.pack`, ``(E, 768)``."""
    if bits.ndim != 2 or bits.shape[1] != PACKED_BYTES or len(bits) == 0:
        raise ValueError(f"expected silhouettes of shape (E, {PACKED_BYTES}), got {bits.shape}")
    dictionary = _by_columns(unpack(bits[_sampled(len(bits))])).ravel()
    blocks = (
        _by_columns(unpack(bits[start : start + _BLOCK])) for start in range(0, len(bits), _BLOCK)
    )
    return Silhouettes(*_deflate(blocks, dictionary))


def halved(silhouettes: Silhouettes) -> Silhouettes:
    """The same at half the resolution, in half the bytes: outlines move by 0.3 px."""
    if silhouettes.step != 1:
        raise ValueError("expected silhouettes at full resolution, got halved ones")
    blocks = [
        _by_columns(
            halve(silhouettes.take(np.arange(start, min(start + _BLOCK, len(silhouettes)))))
        )
        for start in range(0, len(silhouettes), _BLOCK)
    ]
    dictionary = np.concatenate(blocks)[_sampled(len(silhouettes), step=2)].ravel()
    return Silhouettes(*_deflate(blocks, dictionary), step=2)


def _sampled(count: int, *, step: int = 1) -> NDArray[np.int64]:
    """Evenly spaced rows of ``count`` silhouettes, which make up their dictionary."""
    fitting = _WINDOW_BYTES * step**2 // PACKED_BYTES
    return np.linspace(0, count - 1, min(count, fitting)).astype(np.int64)


def _deflate(
    blocks: Iterable[NDArray[np.uint8]], dictionary: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8]]:
    """Compress each row of each block; returns data, ends and dictionary."""
    fresh = zlib.compressobj(_LEVEL, zlib.DEFLATED, RAW_DEFLATE, 9, zdict=dictionary.tobytes())
    parts = []
    for block in blocks:
        for row in block:
            packer = fresh.copy()
            parts.append(packer.compress(row.tobytes()) + packer.flush())
    ends = np.cumsum([len(part) for part in parts], dtype=np.int64)
    return np.frombuffer(b"".join(parts), np.uint8), ends, dictionary


def _by_columns(silhouettes: NDArray[np.uint8] | NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Pack silhouettes ``(B, H, W)``, one column of bytes after the other.

    Outlines are mostly vertical and compress better in this order.
    """
    packed = np.packbits(silhouettes, axis=2).swapaxes(1, 2)
    return np.ascontiguousarray(packed).reshape(len(silhouettes), -1)
