"""Quarter turns: somebody who lies is upright in a frame that is turned.

Turns count counterclockwise, as those of ``numpy.rot90``; the shape is always that of the frame
before it is turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box, Silhouette


def turned_points(
    points: NDArray[np.float64], shape: tuple[int, ...], turns: int
) -> NDArray[np.float64]:
    """Where points ``(..., 2)`` of a frame, x before y, are in the turned one."""
    height, width = shape[:2]
    x, y = points[..., 0], points[..., 1]
    places = ((x, y), (y, width - 1 - x), (width - 1 - x, height - 1 - y), (height - 1 - y, x))
    return np.stack(places[turns % 4], axis=-1)


def turned_shape(shape: tuple[int, ...], turns: int) -> tuple[int, ...]:
    """Rows and columns of the turned frame."""
    return shape[:2] if turns % 2 == 0 else shape[1::-1]


def turned_box(box: Box, shape: tuple[int, ...], turns: int) -> Box:
    """The same box in the turned frame."""
    corners = np.array([[box.x, box.y], [box.right, box.bottom]])
    (left, top), (right, bottom) = np.sort(turned_points(corners, shape, turns), axis=0).tolist()
    return Box(left, top, right - left, bottom - top)


def turned_silhouette(silhouette: Silhouette, shape: tuple[int, ...], turns: int) -> Silhouette:
    """The same silhouette in the turned frame."""
    left, top, _, _ = turned_box(silhouette.box, shape, turns).pixels()
    crop = np.ascontiguousarray(np.rot90(silhouette.crop, turns))
    return replace(silhouette, crop=crop, left=left, top=top)
