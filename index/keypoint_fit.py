"""Skeletons fitted to the keypoints of a photograph, beyond the poses that an index holds.

A pose found is as near as recorded poses come. Where a keypoint shows a wrist elsewhere, the bones
are turned towards it: points move in the picture, keep their depth, and the bones get their lengths
back. From coarse to fine, so that a limb that is far off finds its place, and what no keypoint
shows stays as it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from index.keypoints import Keypoints
from index.modes import with_bones_of
from index.skeleton import JOINTS, POINT_NAMES, exchange_sides

STEPS = ((14.0, 0.7, 4), (7.0, 0.7, 4))
"""How far about a point a keypoint counts, in pixels, which share of the way the point is moved,
and how often. Chosen on the street people of even-numbered photographs."""

_HIPS = [POINT_NAMES.index("left_hip"), POINT_NAMES.index("right_hip")]


def fit_to_keypoints(
    keypoints: Keypoints, points_3d: NDArray[np.float64], points_normalised: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit skeletons to keypoints.

    Parameters
    ----------
    keypoints : Keypoints
    points_3d : (M, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin; rows are ``POINT_NAMES``.
    points_normalised : (M, 24, 2) float64 array
        The same in pixels of the normalised frame.

    Returns
    -------
    points_3d, points_normalised
        Of the same shapes; bones are as long as they were, and the face moves with the head.
    """
    fitted, placed = points_3d, points_normalised
    px_per_metre = _scale(points_3d, points_normalised)[:, None, None]
    for spread_px, share, times in STEPS:
        blurred = replace(keypoints, spread_px=spread_px)
        for _ in range(times):
            moves = share * _pulls(blurred, placed)
            moved = fitted.copy()
            moved[..., :2] += moves / px_per_metre
            moved = with_bones_of(points_3d, moved)
            # The pelvis, which no keypoint shows, goes where the hips go.
            along = moves[:, _HIPS].mean(axis=1, keepdims=True)
            placed = placed + (moved - fitted)[..., :2] * px_per_metre + along
            fitted = moved
    return fitted, placed


def _pulls(keypoints: Keypoints, points_normalised: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each point ``(M, 24, 2)`` is from its keypoint, whichever sides are meant."""
    agreement = keypoints.compare(points_normalised)
    pulls = np.zeros_like(points_normalised)
    pulls[:, list(keypoints.rows)] = agreement.pulls
    exchanged = agreement.side_odds < 0
    pulls[exchanged] = exchange_sides(pulls[exchanged])
    return pulls


def _scale(
    points_3d: NDArray[np.float64], points_normalised: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Pixels a metre ``(M,)`` at which skeletons were projected, perspective aside."""
    metres = points_3d[:, :JOINTS, :2] - points_3d[:, :JOINTS, :2].mean(axis=1, keepdims=True)
    pixels = points_normalised[:, :JOINTS]
    pixels = pixels - pixels.mean(axis=1, keepdims=True)
    return np.asarray((metres * pixels).sum(axis=(1, 2)) / (metres**2).sum(axis=(1, 2)))
