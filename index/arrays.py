"""NumPy's files, read by one thread at a time."""

import io
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PARSING = Lock()
"""NumPy parses a header with :func:`ast.literal_eval`, which is not thread-safe in Python 3.11,
and an index is read while networks are: https://github.com/python/cpython/issues/106905."""


def load_array(content: bytes) -> NDArray[Any]:
    """The array of an ``.npy`` file; raises ValueError or EOFError for anything else."""
    with _PARSING:
        return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))


def load_arrays(source: Path | bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file, by their names.

    Raises
    ------
    OSError, ValueError, EOFError, zipfile.BadZipFile
        If it cannot be read or is something else.
    """
    file = source if isinstance(source, Path) else io.BytesIO(source)
    with _PARSING:
        loaded = np.load(file, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise ValueError("expected an archive of arrays, got one array")
        with loaded:
            return dict(loaded)
