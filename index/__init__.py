"""The silhouette-skeleton database: poses, cameras, search and matching; no HTTP."""

from pathlib import Path

DEFAULT_PATH = Path(__file__).parent / "data"
"""Folder of the index that the package ships."""
