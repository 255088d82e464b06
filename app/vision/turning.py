"""Quarter turns: somebody who lies is upright in a frame that is turned.

Turns count counterclockwise, as those of ``numpy.rot90``; the shape is always that of the frame
before it is turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.vision.people import COCO_NAMES, Box, ObservedKeypoints, Silhouette

LYING_FROM_DEG = 60.0
"""Who leans farther is set upright by quarter turns; the index knows leans up to it."""

_LEAST_SCORE = 0.15
# The body's axis leads from its lower to its upper end: of each the first that is seen.
_LOWER = (("left_ankle", "right_ankle", "left_knee", "right_knee"), ("left_hip", "right_hip"))
_UPPER = (("left_shoulder", "right_shoulder", "nose"),)


def lean_deg(keypoints: ObservedKeypoints) -> float | None:
    """How far the axis of a body is turned from upright, clockwise in the picture.

    From the legs to the shoulders, so that who stands and bends does not lie.

    Returns
    -------
    float or None
        -180 to 180; None where an end of the body is not seen.
    """
    lower, upper = _middle(keypoints, _LOWER), _middle(keypoints, _UPPER)
    if lower is None or upper is None:
        return None
    right, down = upper - lower
    return float(np.rad2deg(np.arctan2(right, -down)))


def turns_upright(keypoints: ObservedKeypoints | None) -> int:
    """Quarter turns counterclockwise that set a person upright; 0 where nothing tells."""
    lean = None if keypoints is None else lean_deg(keypoints)
    if lean is None or abs(lean) < LYING_FROM_DEG:
        return 0
    if abs(lean) > 180 - LYING_FROM_DEG / 2:
        return 2
    return 1 if lean > 0 else 3


def _middle(
    keypoints: ObservedKeypoints, groups: tuple[tuple[str, ...], ...]
) -> NDArray[np.float64] | None:
    for names in groups:
        rows = [COCO_NAMES.index(name) for name in names]
        scores = keypoints.scores[rows]
        if scores.max() >= _LEAST_SCORE:
            return np.asarray(scores @ keypoints.positions[rows] / scores.sum())
    return None


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


def turned_keypoints(
    keypoints: ObservedKeypoints, shape: tuple[int, ...], turns: int
) -> ObservedKeypoints:
    """The same keypoints in the turned frame; left and right are the person's own, and stay."""
    return replace(keypoints, positions=turned_points(keypoints.positions, shape, turns))
