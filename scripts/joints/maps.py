"""Maps of probability that a network which looks for points should answer with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, log_softmax

SPREAD_CELLS = 0.8
"""How far about its place a point counts as found."""


def wanted_maps(
    points: NDArray[np.float32], shape: tuple[int, int], cell: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """What maps should say of points.

    Parameters
    ----------
    points : (N, P, 2) float32 array
        Pixels of a window; they may lie outside.
    shape : (int, int)
        Rows and columns of the maps.
    cell : int
        Pixels of the window that a map has a cell for, each way.

    Returns
    -------
    maps : (N, P, rows, columns) float32 array
        Each sums to 1.
    inside : (N, P) bool array
        Which of the points lie in the window.
    """
    rows, columns = shape
    cells = (points + 0.5) / cell - 0.5
    x = np.exp(-((cells[..., :1] - np.arange(columns)) ** 2) / (2 * SPREAD_CELLS**2))
    y = np.exp(-((cells[..., 1:] - np.arange(rows)) ** 2) / (2 * SPREAD_CELLS**2))
    maps = y[..., :, None] * x[..., None, :]
    last = (columns * cell - 1, rows * cell - 1)
    inside = np.asarray(((points >= 0) & (points <= last)).all(axis=-1))
    sums = np.maximum(maps.sum(axis=(2, 3), keepdims=True), 1e-9)
    return (maps / sums).astype(np.float32), inside


def loss_of(odds: Tensor, wanted: Tensor, inside: Tensor) -> Tensor:
    """Cross entropy of each map, over the points that lie in the window."""
    logs = log_softmax(odds.flatten(2), dim=2)
    crossed = -(wanted.flatten(2) * logs).sum(dim=2)
    return (crossed * inside).sum() / inside.sum()
