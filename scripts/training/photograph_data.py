"""Training data from rendered photographs: one row for each window that the network read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class WindowRows:
    """Windows that the landmark network read, with the truth about them.

    Parameters
    ----------
    scene : (N,) int64 array
        Number of the photograph.
    points, world, presence, last
        As :class:`app.vision.blazepose.NetworkPass` has them, ``N`` of each.
    sampled : (N, 33, 144) float16 array
        The middle map at the landmarks.
    window, next_window : (N, 4) float64 array
        x, y, side, roll in degrees; next: where the network would look.
    focal, centre, frame_px : (N, 2) float64 array
        As :class:`scripts.training.render.scene.Photograph` has them.
    box : (N, 4) float64 array
        About the visible part of the subject.
    posture : (N,) int64 array
        Class, or -1 where nobody is.
    landmarks : (N, 33, 3) float32 array
        Camera axes, metres.
    places : (N, 33, 2) float32 array
        Pixels.
    shown : (N, 33) bool array
    up : (N, 3) float32 array
    covered : (N,) float64 array
    """

    scene: NDArray[np.int64]
    points: NDArray[np.float32]
    world: NDArray[np.float32]
    presence: NDArray[np.float32]
    last: NDArray[np.float16]
    sampled: NDArray[np.float16]
    window: NDArray[np.float64]
    next_window: NDArray[np.float64]
    focal: NDArray[np.float64]
    centre: NDArray[np.float64]
    frame_px: NDArray[np.float64]
    box: NDArray[np.float64]
    posture: NDArray[np.int64]
    landmarks: NDArray[np.float32]
    places: NDArray[np.float32]
    shown: NDArray[np.bool_]
    up: NDArray[np.float32]
    covered: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.scene)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> WindowRows:
        """Some of the rows."""
        return WindowRows(*(getattr(self, part.name)[rows] for part in fields(self)))

    def save(self, file: Path) -> None:
        """Write them as an ``.npz``."""
        np.savez(file, **{part.name: getattr(self, part.name) for part in fields(self)})


def joined(parts: list[WindowRows]) -> WindowRows:
    """Concatenate rows."""
    return WindowRows(
        *(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(WindowRows))
    )


def read_rows(folder: Path) -> WindowRows:
    """Read all rows that ``render-people`` wrote into a folder.

    Raises
    ------
    FileNotFoundError
        If the folder holds none.
    """
    files = sorted(Path(folder).glob("windows-*.npz"))
    if not files:
        raise FileNotFoundError(f"expected windows-*.npz in {folder}, found none")
    return joined(list(_read(files)))


def _read(files: list[Path]) -> Iterator[WindowRows]:
    for file in files:
        with np.load(file) as stored:
            yield WindowRows(*(stored[part.name] for part in fields(WindowRows)))
