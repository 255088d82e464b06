"""A contact sheet of sequences: the truth, every frame by itself, and the smooth pose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.api.overlay import draw_skeleton
from app.vision.people import Silhouette
from index.skeleton import NATIVE
from scripts.experiments.sequences import Filmed

SEQUENCES, FRAMES = 5, 10
TILE = (110, 190)
"""Columns and rows of a picture."""

SECONDS = 2.0
"""Shown of each sequence."""


def draw_sequences(
    sequences: Sequence[Filmed],
    alone: Sequence[NDArray[np.float64]],
    smooth: Sequence[NDArray[np.float64]],
    file: Path,
) -> None:
    """Draw sequences evenly chosen over all, in three rows each.

    The person's left is orange, the right blue. From above: the truth, the first hypothesis of
    every frame, the smooth pose.

    Parameters
    ----------
    sequences : sequence of Filmed
    alone, smooth : sequence of (F, 24, 2) float64 array
        Points in the picture, of each sequence.
    file : Path
    """
    chosen = np.linspace(0, len(sequences) - 1, SEQUENCES).astype(int)
    rows = []
    for number in chosen.tolist():
        filmed = sequences[number]
        shown = int((filmed.timestamps <= SECONDS).sum())
        frames = np.linspace(0, shown - 1, min(FRAMES, shown)).astype(int).tolist()
        for points in (filmed.points_2d, alone[number], smooth[number]):
            tiles = [_tile(filmed.silhouettes[frame], points[frame]) for frame in frames]
            tiles += [np.full_like(tiles[0], 255)] * (FRAMES - len(tiles))
            rows.append(np.hstack(tiles))
        rows.append(np.full((12, rows[-1].shape[1], 3), 255, np.uint8))
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), np.vstack(rows[:-1]))


def _tile(silhouette: Silhouette, points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """One silhouette with a skeleton ``(24, 2)``, fitted into the tile."""
    columns, rows = TILE
    height, width = silhouette.crop.shape
    scale = 0.9 * min(columns / width, rows / height)
    offset = np.array([(columns - scale * width) / 2, (rows - scale * height) / 2])
    transform = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
    grey = np.where(silhouette.crop, 190, 60).astype(np.uint8)
    tile = np.empty((rows, columns, 3), np.uint8)
    cv2.warpAffine(
        cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), transform, TILE, tile, borderValue=(60, 60, 60)
    )
    corner = np.array([silhouette.left, silhouette.top])
    draw_skeleton(tile, scale * (points - corner) + offset, NATIVE, 1)
    return tile
