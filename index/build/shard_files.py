"""Shards and avatars as files in a folder that all who draw can reach.

A file is named by the hash of what it was computed from, and appears under its name only when it
is whole: what is there can be used, by this build or by a later one.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import numba
import numpy as np
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.views import Drawn, Shard, draw

_PACKAGES = Path(__file__).resolve().parents[2]


class ShardError(RuntimeError):
    """A shard that could not be drawn or read; the message is one sentence."""


@dataclass(frozen=True)
class Task:
    """A shard to draw into a file.

    Parameters
    ----------
    shard : Shard
    avatars : Path
        File of the avatars.
    file : Path
        Where the silhouettes go.
    code : str
        The :func:`code_version` that the file's name stands for.
    """

    shard: Shard
    avatars: Path
    file: Path
    code: str


@lru_cache(maxsize=1)
def code_version() -> str:
    """What computes here: a hash of the sources, and versions that decide the bytes of a shard."""
    sources = hashlib.sha256()
    for package in ("descriptor", "index"):
        for file in sorted((_PACKAGES / package).rglob("*.py")):
            sources.update(f"{file.relative_to(_PACKAGES)}\0".encode() + file.read_bytes())
    return (
        f"sources {sources.hexdigest()[:12]}, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, Numba {numba.__version__}"
    )


def name_of(shard: Shard, avatars: Path, code: str) -> str:
    """Name of the file of a shard: what it is computed from, hashed."""
    return f"shard-{_digest({**vars(shard), 'avatars': avatars.name, 'code': code})}.npz"


def perform(task: Task) -> int:
    """Draw a shard into its file; return how many bodies it holds.

    Raises
    ------
    ShardError
        If the code here is not that of the task, or the avatars are not to be found.
    """
    if code_version() != task.code:
        raise ShardError(
            f"a worker on {platform.node()} runs other code ({code_version()}) than this build "
            f"({task.code})"
        )
    try:
        avatars = read_avatars(task.avatars)
    except OSError as error:
        raise ShardError(
            f"a worker on {platform.node()} cannot read {task.avatars}: the folder of the shards "
            f"must be shared by all ({error.strerror})"
        ) from error
    _write(task.file, vars(draw(task.shard, avatars)))
    return len(task.shard)


def read_drawn(file: Path) -> Drawn:
    """Read the silhouettes of a shard.

    Raises
    ------
    ShardError
        If the file is missing or damaged.
    """
    try:
        return Drawn(**_read(file))
    except FileNotFoundError as error:
        raise ShardError(
            f"the shard {file} is missing: the folder of the shards must be shared by all"
        ) from error
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ShardError(f"the shard {file} is damaged; remove it and build again") from error


def write_avatars(avatars: Sequence[Avatar], folder: Path) -> Path:
    """Write avatars into a folder, unless they are there, and return their file."""
    fields = {
        f"{number}.{name}": value
        for number, avatar in enumerate(avatars)
        for name, value in vars(avatar).items()
    }
    file = folder / f"avatars-{_digest(fields)}.npz"
    if not file.exists():
        _write(file, fields)
    return file


@lru_cache(maxsize=2)
def read_avatars(file: Path) -> tuple[Avatar, ...]:
    """Read avatars; those read last are kept in memory."""
    fields = _read(file)
    avatars = []
    for number in range(1 + max(int(name.split(".")[0]) for name in fields)):
        own: dict[str, Any] = {
            name.split(".")[1]: value
            for name, value in fields.items()
            if name.startswith(f"{number}.")
        }
        own["name"], own["closed"] = str(own["name"]), int(own["closed"])
        own["bones"], own["parents"] = tuple(own["bones"].tolist()), tuple(own["parents"].tolist())
        avatars.append(Avatar(**own))
    return tuple(avatars)


def _digest(values: Mapping[str, Any]) -> str:
    """SHA-256 of named arrays and of what NumPy makes arrays of."""
    total = hashlib.sha256()
    for name, value in sorted(values.items()):
        array = np.ascontiguousarray(value)
        total.update(f"{name} {array.dtype.str} {array.shape}\0".encode() + array.tobytes())
    return total.hexdigest()


def _write(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as an ``.npz`` file, which appears under its name when it is whole."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    unfinished = file.with_name(f".unfinished-{uuid4().hex}")
    try:
        with unfinished.open("wb") as stream:
            stream.write(content.getbuffer())
            stream.flush()
            os.fsync(stream.fileno())
        unfinished.replace(file)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def _read(file: Path) -> dict[str, NDArray[Any]]:
    with np.load(file, allow_pickle=False) as arrays:
        return dict(arrays)
