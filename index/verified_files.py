"""Reading the files of an index artefact: decompressed and verified against their SHA-256."""

from __future__ import annotations

import hashlib
import io
import lzma
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=np.generic)

_CHUNK = 1 << 20

_PARSING = Lock()
"""NumPy parses a header with :func:`ast.literal_eval`, which is not thread-safe in Python 3.11:
https://github.com/python/cpython/issues/106905."""


class ArtefactError(ValueError):
    """An index artefact that cannot be used; the message says why in one sentence."""


def npy_bytes(array: NDArray[np.generic]) -> bytes:
    """Serialise an array as the content of an ``.npy`` file."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


class _HashingReader(io.RawIOBase):
    """A file read sequentially, decompressed if its name ends in ``.xz``, and hashed."""

    def __init__(self, file: Path) -> None:
        # Closed with the reader.
        self._stream = lzma.open(file) if file.suffix == ".xz" else file.open("rb")  # noqa: SIM115
        self._hash = hashlib.sha256()

    def read(self, size: int = -1) -> bytes:
        content = self._stream.read(size)
        self._hash.update(content)
        return content

    def close(self) -> None:
        self._stream.close()
        super().close()

    def finish(self) -> str:
        """Read the rest of the file and return the hash of all of it."""
        while self.read(_CHUNK):
            pass
        return self._hash.hexdigest()


def read_array(file: Path, sha256: str) -> NDArray[np.generic]:
    """Read an array, decompressed if the file ends in ``.xz``, and verify it.

    Raises
    ------
    ArtefactError
        If the file is missing, truncated, altered or not an array.
    """
    return _read_file(file, sha256, _parse_array)


def _parse_array(stream: io.RawIOBase) -> NDArray[np.generic]:
    with _PARSING:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ValueError(f"expected version 1.0 of the NPY format, got {version}")
        shape, fortran_order, dtype = np.lib.format.read_array_header_1_0(stream)
    if fortran_order or dtype.hasobject:
        raise ValueError(f"expected plain values in C order, got {dtype}, {fortran_order=}")
    array = np.empty(shape, dtype)
    content = array.reshape(-1).view(np.uint8).data
    done = 0
    while done < len(content):
        chunk = stream.read(min(_CHUNK, len(content) - done))
        if not chunk:
            raise ValueError(f"expected {len(content)} bytes of values, got {done}")
        content[done : done + len(chunk)] = chunk
        done += len(chunk)
    return array


def read_bytes(file: Path, sha256: str) -> NDArray[np.uint8]:
    """Read any file as bytes ``(N,)``, decompressed if it ends in ``.xz``, and verify it."""
    return _read_file(file, sha256, lambda stream: np.frombuffer(stream.read(), np.uint8))


def _read_file(
    file: Path, sha256: str, parse: Callable[[_HashingReader], NDArray[T]]
) -> NDArray[T]:
    altered = f"the index file {file} was altered: its SHA-256 does not fit"
    try:
        with _HashingReader(file) as stream:
            try:
                content = parse(stream)
            except ValueError as error:
                # With the right hash, the file was already malformed when it was written.
                raise ArtefactError(
                    altered if stream.finish() != sha256 else f"{file} is no array: {error}"
                ) from error
            if stream.finish() != sha256:
                raise ArtefactError(altered)
            return content
    except OSError as error:
        raise ArtefactError(f"the index file {file} cannot be read: {error.strerror}") from error
    except (EOFError, lzma.LZMAError) as error:
        raise ArtefactError(f"the index file {file} is truncated or altered: {error}") from error
