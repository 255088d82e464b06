"""The shipped networks, and the constants fitted to their outputs.

``models.json`` gives each network's description, source, conversion and SHA-256. ``fitted.json``
gives the constants, with the command that fits them and the data they were fitted to.
"""

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from app.vision.tflite import NetworkError

FOLDER = Path(__file__).parent
FITTED = FOLDER / "fitted.json"
MODELS = FOLDER / "models.json"


def network_path(name: str) -> Path:
    """Path of the network that ``models.json`` calls ``name``, its content verified.

    Raises
    ------
    NetworkError
        If the file is missing or is not the shipped one.
    """
    model = json.loads(MODELS.read_text())[name]
    path = FOLDER / str(model["file"])
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise NetworkError(f"cannot read the network {name}: {error}") from None
    if found != model["sha256"]:
        raise NetworkError(f"expected {path} to have the SHA-256 {model['sha256']}, got {found}")
    return path


def check_networks() -> None:
    """Raise :class:`NetworkError` if a network's file is not the shipped one."""
    for name in json.loads(MODELS.read_text()):
        network_path(name)


@cache
def fitted_constants(name: str) -> dict[str, Any]:
    """The constants of one part of ``fitted.json``."""
    constants: dict[str, Any] = json.loads(FITTED.read_text())[name]["constants"]
    return constants
