"""What a command writes never takes the place of what it reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Raise a ``ValueError`` if a file is to be written that is read as well."""
    read = {file.resolve() for file in inputs if file is not None}
    for file in outputs:
        if file is not None and file.resolve() in read:
            raise ValueError(f"expected another place to write to than the input {file}")
