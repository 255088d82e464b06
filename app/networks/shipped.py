"""The files of what was learned, which ship with the package; none is used unverified.

``models/models.json`` names each file, what it is, its source, its licence, what made it, and its
SHA-256. :func:`app.photograph.load_models` loads all of them before the service is ready.
"""

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from numpy.typing import NDArray

from index.arrays import load_arrays

FOLDER = Path(__file__).parent / "models"
LIST = FOLDER / "models.json"


class NetworkError(RuntimeError):
    """A file of what was learned is missing, altered or not what was expected."""


@cache
def file_of(name: str) -> Path:
    """Path of the file that ``models.json`` calls ``name``, its content verified.

    Raises
    ------
    NetworkError
        If the file is missing or is not the shipped one.
    """
    model = json.loads(LIST.read_text())[name]
    path = FOLDER / str(model["file"])
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise NetworkError(f"cannot read {path}: {error.strerror}") from None
    if found != model["sha256"]:
        raise NetworkError(f"expected {path} to have the SHA-256 {model['sha256']}, got {found}")
    return path


def check_files() -> None:
    """Raise :class:`NetworkError` if a file is not the shipped one."""
    for name in json.loads(LIST.read_text()):
        file_of(name)


def arrays_of(name: str) -> dict[str, NDArray[Any]]:
    """The arrays of a verified file, by their names; raises like :func:`file_of`."""
    return read_arrays(file_of(name))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file, by their names.

    Raises
    ------
    NetworkError
        If the file is missing or holds something else.
    """
    try:
        return load_arrays(path)
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise NetworkError(f"cannot read the arrays in {path}: {error}") from error


@cache
def constants_of(part: str) -> dict[str, Any]:
    """The constants of one part of ``fitted.json``, which were fitted to outputs of networks."""
    constants: dict[str, Any] = json.loads(file_of("fitted").read_text())[part]["constants"]
    return constants
