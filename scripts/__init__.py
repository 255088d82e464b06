"""Command lines: builds, experiments, pictures, load tests.

What a command lacks is told in one sentence rather than by a trace.
"""

from __future__ import annotations

import sys
from types import TracebackType


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say what is missing, where that is a package or a file."""
    program = getattr(getattr(sys.modules.get("__main__"), "__spec__", None), "name", "scripts")
    if isinstance(error, ModuleNotFoundError) and error.name:
        sys.stderr.write(
            f"{program}: expected the package {error.name.partition('.')[0]}, which `make "
            f".venv-build/.stamp` installs: then `.venv-build/bin/python -m {program}`\n"
        )
    elif any(isinstance(found, FileNotFoundError) for found in (error, error.__cause__)):
        sys.stderr.write(f"{program}: {error}; --shared names the folder of data\n")
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _tell
