"""The tracks that a camera session had of rendered films, as ``render-films`` wrote them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scripts.training.fall_tracks import Track
from scripts.training.motion_library import trunk_is_up
from scripts.training.render.film import RATE


def film_tracks(folder: Path) -> Iterator[Track]:
    """Every track of the films of a folder, also those of things."""
    for file in sorted(folder.glob("film-????.npz")):
        with np.load(file) as arrays:
            rows, tracks, left = arrays["rows"], arrays["tracks"], arrays["left"]
            fell = np.where(arrays["fell"] < 0, np.inf, arrays["fell"])
        if not len(tracks):
            continue
        up = {(int(row[0]), int(row[1])): row[-1] for row in _with_trunks(rows)}
        for identity in np.unique(tracks[:, 1]):
            own = tracks[tracks[:, 1] == identity]
            people, counts = np.unique(own[:, 2], return_counts=True)
            person = int(people[counts.argmax()])
            falls, down = fell if person == 0 else (np.inf, np.inf)
            lost_at = next((float(row[1]) for row in left if row[0] == identity), None)
            alone = lost_at is None or not _meets(tracks, own, lost_at)
            is_up = np.array([up.get((int(row[0]), person), False) for row in own], bool)
            yield Track(own[:, 0] / RATE, own[:, 3:], falls, down, is_up, lost_at, alone, 0.0)


def _with_trunks(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Frame, person and whether the trunk is up ``(N, 3)``, of rows with joints in camera axes."""
    if not len(rows):
        return np.empty((0, 3))
    joints, down_axis = rows[:, 8:80].reshape(-1, 24, 3), rows[:, 5:8]
    heights = -np.einsum("njk,nk->nj", joints, down_axis)
    return np.column_stack([rows[:, :2], trunk_is_up(joints, heights)])


def _meets(tracks: NDArray[np.float64], own: NDArray[np.float64], lost_at: float) -> bool:
    """Whether another person is seen where one was seen last, when their track ends."""
    others = tracks[(tracks[:, 1] != own[0, 1]) & (tracks[:, 0] == round(lost_at * RATE))]
    low = np.maximum(others[:, 3:5], own[-1, 3:5])
    high = np.minimum(others[:, 5:7], own[-1, 5:7])
    return bool((high > low).all(axis=1).any())
