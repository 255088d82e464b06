"""Files of an index, read and verified."""

from __future__ import annotations

import hashlib
import io
import lzma
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

_PARSING = Lock()
"""NumPy parses a header with :func:`ast.literal_eval`, which is not thread-safe in Python 3.11:
https://github.com/python/cpython/issues/106905."""


class ArtefactError(ValueError):
    """An index artefact that cannot be used; the message says why in one sentence."""


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
