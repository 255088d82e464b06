"""Files of an index: read and verified, and written in folders that replace whole folders."""

from __future__ import annotations

import fcntl
import glob
import hashlib
import io
import lzma
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

_PARSING = Lock()
"""NumPy parses a header with :func:`ast.literal_eval`, which is not thread-safe in Python 3.11:
https://github.com/python/cpython/issues/106905."""

STAGING_MARK = ".silhouette-pose-staging"
"""File in every staging folder; it holds the name of the folder that is to be written."""

_NEW, _OLD = "new", "old"


class ArtefactError(ValueError):
    """An index artefact that cannot be used; the message says why in one sentence."""


def npy_bytes(array: NDArray[np.generic]) -> bytes:
    """Serialise an array as the content of an ``.npy`` file."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def read_array(file: Path, sha256: str) -> NDArray[np.generic]:
    """Read an ``.npy`` file, decompressed if its name ends in ``.xz``, and verify it.

    Raises
    ------
    ArtefactError
        If the file is missing, truncated, altered or not an array.
    """
    content = read_bytes(file, sha256)
    try:
        with _PARSING:
            return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))
    except (ValueError, EOFError) as error:
        raise ArtefactError(f"{file} is no array: {error}") from error


def read_bytes(file: Path, sha256: str) -> bytes:
    """Read a file, decompressed if its name ends in ``.xz``, and verify it.

    Raises
    ------
    ArtefactError
        If the file is missing, truncated or altered.
    """
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


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """Make a folder beside ``path`` for the time of a build.

    It is removed at the end. If a build is killed, the next build of the same path removes its
    folder.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_leftovers(path)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    # The folder is locked before it is marked, so that another build never sees it marked and free.
    held = lock(folder)
    try:
        (folder / STAGING_MARK).write_bytes(os.fsencode(path.name))
        yield folder
    finally:
        _clear(folder, path)
        if held is not None:
            os.close(held)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces ``path`` at the end.

    If anything fails, the old folder stays or is put back.
    """
    with staging(path) as folder:
        new = folder / _NEW
        new.mkdir()
        yield new
        if path.exists():
            path.rename(folder / _OLD)
        new.rename(path)


def lock(folder: Path) -> int | None:
    """Lock a folder until the process ends; None if another process holds the lock."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _clear_leftovers(path: Path) -> None:
    """Remove staging folders of killed builds; running builds have locked theirs."""
    for folder in path.parent.glob(f".{glob.escape(path.name)}-*"):
        if _is_staging_of(folder, path) and (held := lock(folder)) is not None:
            _clear(folder, path)
            os.close(held)


def _is_staging_of(folder: Path, path: Path) -> bool:
    with suppress(OSError):
        return not folder.is_symlink() and (folder / STAGING_MARK).read_bytes() == os.fsencode(
            path.name
        )
    return False


def _clear(folder: Path, path: Path) -> None:
    """Remove a staging folder, after putting back an old folder that was not replaced."""
    old = folder / _OLD
    if old.exists() and not path.exists():
        old.rename(path)
    shutil.rmtree(folder, ignore_errors=True)
