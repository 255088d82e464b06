"""Shards and avatars as files in a folder that all processes of a build can reach.

A file is named by the hash of what it is computed from and appears under its name once it is
complete, so that an interrupted build can be resumed.
"""

from __future__ import annotations

import hashlib
import platform
import zipfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import numba
import numpy as np
from numpy.typing import NDArray

from index.build.body import Avatar
from index.build.views import RenderedShard, Shard, render_bodies

_PACKAGES = Path(__file__).resolve().parents[2]


class ShardError(RuntimeError):
    """Silhouettes that cannot be rendered or read; the message is one sentence."""


@lru_cache(maxsize=1)
def code_version() -> str:
    """Hash of the sources, and the versions that decide the bytes of a shard."""
    sources = hashlib.sha256()
    for package in ("descriptor", "index"):
        for file in sorted((_PACKAGES / package).rglob("*.py")):
            sources.update(f"{file.relative_to(_PACKAGES)}\0".encode() + file.read_bytes())
    return (
        f"sources {sources.hexdigest()[:12]}, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, Numba {numba.__version__}"
    )


def shard_name(shard: Shard, avatars: Path, code: str) -> str:
    """Name of the file of a shard: the hash of its inputs."""
    return f"shard-{_digest({**vars(shard), 'avatars': avatars.name, 'code': code})}.npz"


def render_shard(shard: Shard, avatars: Path, file: Path, code: str) -> int:
    """Render a shard into a file; return how many bodies it holds.

    Parameters
    ----------
    shard : Shard
    avatars : Path
        File that :func:`write_avatars` wrote.
    file : Path
        Where the silhouettes go.
    code : str
        The :func:`code_version` of the build.

    Raises
    ------
    ShardError
        If the code here is another one, or the avatars cannot be read.
    """
    if code_version() != code:
        raise ShardError(
            f"a worker on {platform.node()} runs other code ({code_version()}) than this build "
            f"({code})"
        )
    try:
        bodies = read_avatars(avatars)
    except OSError as error:
        raise ShardError(
            f"a worker on {platform.node()} cannot read {avatars}: the folder of the shards "
            f"must be shared by all ({error.strerror})"
        ) from error
    _write(file, vars(render_bodies(shard, bodies)))
    return len(shard)


def read_shard(file: Path) -> RenderedShard:
    """Read the silhouettes of a shard.

    Raises
    ------
    ShardError
        If the file is missing or damaged.
    """
    try:
        return RenderedShard(**_read(file))
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
    """Read avatars; the last two files stay in memory."""
    avatars: dict[int, dict[str, Any]] = {}
    for key, value in _read(file).items():
        number, name = key.split(".")
        # Everything but the arrays: names, and a number of triangles.
        plain = name in ("name", "closed", "bones", "parents")
        avatars.setdefault(int(number), {})[name] = value.tolist() if plain else value
    return tuple(
        Avatar(**{**own, "bones": tuple(own["bones"]), "parents": tuple(own["parents"])})
        for _, own in sorted(avatars.items())
    )


def _digest(values: Mapping[str, Any]) -> str:
    """SHA-256 of named arrays and of what NumPy makes arrays of."""
    total = hashlib.sha256()
    for name, value in sorted(values.items()):
        array = np.ascontiguousarray(value)
        total.update(f"{name} {array.dtype.str} {array.shape}\0".encode() + array.tobytes())
    return total.hexdigest()


def _write(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as an ``.npz`` file, which appears under its name once it is complete."""
    unfinished = file.with_name(f".unfinished-{uuid4().hex}")
    try:
        with unfinished.open("wb") as stream:
            np.savez(stream, **arrays)
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


def _read(file: Path) -> dict[str, NDArray[Any]]:
    with np.load(file, allow_pickle=False) as arrays:
        return dict(arrays)
