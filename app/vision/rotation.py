"""Quarter turns: people who lie are upright in a rotated frame.

They count counterclockwise, as those of ``numpy.rot90``; the shape is always that of the frame
before it is rotated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.vision.people import COCO_NAMES, Box, ObservedKeypoints, Silhouette

LYING_FROM_DEG = 60.0
"""People who lean farther are read in a frame turned by quarters."""

_LEAST_SCORE = 0.15
# The body's axis leads from its lower to its upper end: for each, the first group that is seen.
_LOWER = (("left_ankle", "right_ankle", "left_knee", "right_knee"), ("left_hip", "right_hip"))
_UPPER = (("left_shoulder", "right_shoulder", "nose"),)


def measure_lean_deg(keypoints: ObservedKeypoints) -> float | None:
    """Angle of a body's axis from upright, clockwise in the picture.

    From the legs to the shoulders, so that people who bend over while standing do not count as
    lying.

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


def find_quarter_turns(keypoints: ObservedKeypoints | None) -> int:
    """Quarter turns counterclockwise that set a person upright; 0 if the keypoints do not tell."""
    lean = None if keypoints is None else measure_lean_deg(keypoints)
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


def rotate_points(
    points: NDArray[np.float64], shape: tuple[int, ...], quarter_turns: int
) -> NDArray[np.float64]:
    """Rotate points ``(..., 2)``, x before y, with their frame."""
    height, width = shape[:2]
    x, y = points[..., 0], points[..., 1]
    places = ((x, y), (y, width - 1 - x), (width - 1 - x, height - 1 - y), (height - 1 - y, x))
    return np.stack(places[quarter_turns % 4], axis=-1)


def rotate_shape(shape: tuple[int, ...], quarter_turns: int) -> tuple[int, ...]:
    """Return rows and columns of the rotated frame."""
    return shape[:2] if quarter_turns % 2 == 0 else shape[1::-1]


def rotate_box(box: Box, shape: tuple[int, ...], quarter_turns: int) -> Box:
    """Rotate a box with its frame."""
    corners = np.array([[box.x, box.y], [box.right, box.bottom]])
    corners = np.sort(rotate_points(corners, shape, quarter_turns), axis=0)
    (left, top), (right, bottom) = corners.tolist()
    return Box(left, top, right - left, bottom - top)


def rotate_silhouette(
    silhouette: Silhouette, shape: tuple[int, ...], quarter_turns: int
) -> Silhouette:
    """Rotate a silhouette with its frame."""
    left, top, _, _ = rotate_box(silhouette.box, shape, quarter_turns).pixels()
    crop = np.ascontiguousarray(np.rot90(silhouette.crop, quarter_turns))
    return replace(silhouette, crop=crop, left=left, top=top)


def rotate_keypoints(
    keypoints: ObservedKeypoints, shape: tuple[int, ...], quarter_turns: int
) -> ObservedKeypoints:
    """Rotate keypoints with their frame; left and right are the person's own, and stay."""
    return replace(keypoints, positions=rotate_points(keypoints.positions, shape, quarter_turns))
