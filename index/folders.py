"""Atomic replacement of folders."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# From fcntl.h and fs.h of Linux.
_AT_FDCWD = -100
_EXCHANGE = 2


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """A new folder beside ``path``, removed at the end; if killed, by the next of the same path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    clear_left_overs(path)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    held = lock(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if held is not None:
            os.close(held)


def clear_left_overs(path: Path) -> None:
    """Remove staging folders of killed builds; running builds hold a lock on theirs."""
    for folder in path.parent.glob(f".{path.name}-*"):
        held = lock(folder)
        if held is not None:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(held)


def lock(folder: Path) -> int | None:
    """Lock a folder until the process ends; None if another process holds the lock."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def replace_folder(source: Path, target: Path) -> None:
    """Move ``source`` to ``target``; an existing target may end up where ``source`` was."""
    if not target.exists():
        source.rename(target)
    elif not _exchange(source, target):
        _set_aside_and_rename(source, target)


def _exchange(source: Path, target: Path) -> bool:
    """Exchange two folders atomically; False where the system cannot."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):  # Not glibc, or not Linux.
        return False
    return bool(
        renameat2(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), _EXCHANGE) == 0
    )


def _set_aside_and_rename(source: Path, target: Path) -> None:
    """Replace a folder in two steps; undo the first if the second fails."""
    aside = Path(tempfile.mkdtemp(prefix=f"{target.name}-old-", dir=target.parent))
    target.rename(aside / target.name)
    try:
        source.rename(target)
    except OSError:
        (aside / target.name).rename(target)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
