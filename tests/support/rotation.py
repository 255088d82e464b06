"""Quarter turns of a frame, and of what is known of it.

They count counterclockwise, as those of ``numpy.rot90``; the shape is always that of the frame
before it is rotated.
"""

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box


def rotate_points(
    points: NDArray[np.float64], shape: tuple[int, ...], quarter_turns: int
) -> NDArray[np.float64]:
    """Rotate points ``(..., 2)``, x before y, with their frame."""
    height, width = shape[:2]
    x, y = points[..., 0], points[..., 1]
    places = ((x, y), (y, width - 1 - x), (width - 1 - x, height - 1 - y), (height - 1 - y, x))
    return np.stack(places[quarter_turns % 4], axis=-1)


def rotate_box(box: Box, shape: tuple[int, ...], quarter_turns: int) -> Box:
    """Rotate a box with its frame."""
    corners = np.array([[box.x, box.y], [box.right, box.bottom]])
    corners = np.sort(rotate_points(corners, shape, quarter_turns), axis=0)
    (left, top), (right, bottom) = corners.tolist()
    return Box(left, top, right - left, bottom - top)
