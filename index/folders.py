"""Folders that are whole or not there, whatever happens to whoever writes them."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import tempfile
from pathlib import Path

# From Linux' fcntl.h and fs.h.
_AT_FDCWD = -100
_EXCHANGE = 2


def clear_left_overs(path: Path) -> None:
    """Remove what builds of this artefact left that were killed; others keep theirs locked."""
    for folder in path.parent.glob(f".{path.name}-*"):
        held = lock(folder)
        if held is not None:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(held)


def lock(folder: Path) -> int | None:
    """Lock a folder until its process ends; None where another process has."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def replace_folder(source: Path, target: Path) -> None:
    """Put ``source`` where ``target`` is; an old target is then where ``source`` was."""
    if not target.exists():
        source.rename(target)
    elif not _exchange(source, target):
        _set_aside_and_rename(source, target)


def _exchange(source: Path, target: Path) -> bool:
    """Exchange two folders in one step, so that no kill comes between; False where none can."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):  # Another C library than glibc, another system.
        return False
    return bool(
        renameat2(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), _EXCHANGE) == 0
    )


def _set_aside_and_rename(source: Path, target: Path) -> None:
    """Replace a folder in two steps, and take the first back where the second fails."""
    aside = Path(tempfile.mkdtemp(prefix=f"{target.name}-old-", dir=target.parent))
    target.rename(aside / target.name)
    try:
        source.rename(target)
    except OSError:
        (aside / target.name).rename(target)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
