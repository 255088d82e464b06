"""The version of the service, as it was packaged."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def _version() -> str:
    try:
        return version("silhouette-pose")
    except PackageNotFoundError:  # Run from a checkout that was never installed.
        return "0.0.0"


VERSION = _version()
