"""Folders written beside their place and moved there whole."""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MARK = ".silhouette-pose-staging"
"""A file in every staging folder; it holds the name of the folder that is to be written."""

_NEW, _OLD = "new", "old"


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """Make a folder beside ``path`` for the time of a build.

    It is removed at the end; that of a killed build is removed by the next build of the same path.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_leftovers(path)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    # Locked before it is marked: another build never sees it marked and free.
    held = lock(folder)
    try:
        (folder / MARK).write_bytes(os.fsencode(path.name))
        yield folder
    finally:
        _clear(folder, path)
        if held is not None:
            os.close(held)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield an empty folder that takes the place of ``path`` once it is filled.

    Whatever fails on the way, the old folder stays or is put back.
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
    """Remove staging folders of killed builds; running builds hold a lock on theirs."""
    for folder in path.parent.glob(f".{glob.escape(path.name)}-*"):
        if _is_staging_of(folder, path) and (held := lock(folder)) is not None:
            _clear(folder, path)
            os.close(held)


def _is_staging_of(folder: Path, path: Path) -> bool:
    with suppress(OSError):
        return not folder.is_symlink() and (folder / MARK).read_bytes() == os.fsencode(path.name)
    return False


def _clear(folder: Path, path: Path) -> None:
    """Remove a staging folder, after putting back an old folder that was not replaced."""
    old = folder / _OLD
    if old.exists() and not path.exists():
        old.rename(path)
    shutil.rmtree(folder, ignore_errors=True)
