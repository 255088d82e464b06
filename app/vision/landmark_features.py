"""Feature maps of the landmark network at the landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.vision.people import landmark_rows

LANDMARKS = 33
_WINDOW_PX = 256
_TRUNK, _LEGS = landmark_rows("shoulder", "hip"), landmark_rows("knee", "ankle")


def sample_map(maps: NDArray[np.float32], points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Interpolate feature maps linearly at the landmarks.

    Parameters
    ----------
    maps : (N, S, S, C) float32 array
    points : (N, 39, 5) array
        Pixels of the window in the first two columns, see
        :class:`app.vision.network_pass.NetworkPass`.

    Returns
    -------
    (N, 33, C) float32 array
        Beyond the map's outermost cells, their values are repeated.
    """
    count, size = maps.shape[:2]
    places = points[:, :LANDMARKS, :2].astype(np.float64) * (size / _WINDOW_PX) - 0.5
    places = np.clip(places, 0.0, size - 1.0)
    first = np.minimum(places.astype(int), size - 2)
    share = (places - first).astype(np.float32)
    rows = np.arange(count)[:, None]
    x, y = first[..., 0], first[..., 1]
    across, down = share[..., :1], share[..., 1:]
    top = (1 - across) * maps[rows, y, x] + across * maps[rows, y, x + 1]
    bottom = (1 - across) * maps[rows, y + 1, x] + across * maps[rows, y + 1, x + 1]
    return np.asarray((1 - down) * top + down * bottom, np.float32)


def region_features(sampled: NDArray[np.floating]) -> NDArray[np.float32]:
    """Means over the trunk and over the legs ``(N, 2 C)`` of a map at the landmarks ``(N, 33, C)``.

    They show what surrounds a body, such as a seat, a blanket, or a table in front of the legs.
    """
    parts = [sampled[:, rows].astype(np.float32).mean(axis=1) for rows in (_TRUNK, _LEGS)]
    return np.hstack(parts)
