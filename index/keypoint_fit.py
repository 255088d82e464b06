"""Fitting skeletons to the landmarks of a photograph.

An index gives the nearest of its recorded poses. The fit then rotates bones towards the landmarks
and resets the bones to their lengths. In the picture it goes from coarse to fine, so that limbs far
from their keypoints are found as well. Points without a landmark keep their position relative to
their parents.

In depth the landmarks are one opinion, the pose another. The first skeleton goes most of the way to
them; the others only where they nearly agree, so that they keep their other ways to read the depth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from index.keypoints import SPREAD_M, Keypoints
from index.modes import pixels_per_metre, with_bones_of
from index.skeleton import LIMBS, OTHER_SIDE, POINT_NAMES

STEPS = ((14.0, 0.7, 4), (7.0, 0.7, 10))
"""Stages of the fit: spread of the keypoints in pixels, share of the way that a point moves in an
iteration, and iterations. Chosen on the street people of even-numbered photographs."""

DEPTH_SHARE = 0.6
"""Share of the way to the landmarks' depths that the fit goes in all."""

_LIMB_ROWS = [POINT_NAMES.index(name) for name in LIMBS]
_HIPS = [POINT_NAMES.index("left_hip"), POINT_NAMES.index("right_hip")]


def fit_to_keypoints(
    keypoints: Keypoints, points_3d: NDArray[np.float64], points_normalised: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit skeletons to keypoints.

    Parameters
    ----------
    keypoints : Keypoints
    points_3d : (M, 24, 3) float64 array
        Camera axes, metres, pelvis at the origin; rows are ``POINT_NAMES``. The likeliest first.
    points_normalised : (M, 24, 2) float64 array
        Pixels of the normalised frame.

    Returns
    -------
    points_3d, points_normalised
        Same shapes; bones keep their lengths, and the face moves with the head.
    """
    fitted, placed = points_3d, points_normalised
    px_per_metre = pixels_per_metre(points_3d, points_normalised)[:, None, None]
    if keypoints.limbs_3d is not None:
        fitted = with_bones_of(points_3d, _deepened(keypoints, points_3d))
        placed = placed + (fitted - points_3d)[..., :2] * px_per_metre
    for spread_px, share, iterations in STEPS:
        blurred = replace(keypoints, spread_px=spread_px)
        rows = _assigned(blurred, blurred.compare(placed, fitted).side_log_odds < 0)
        for _ in range(iterations):
            moves = share * _residuals(blurred, placed, rows)
            moved = fitted.copy()
            moved[..., :2] += moves / px_per_metre
            moved = with_bones_of(points_3d, moved)
            # The pelvis has no keypoint and follows the hips.
            pelvis_moves = moves[:, _HIPS].mean(axis=1, keepdims=True)
            placed = placed + (moved - fitted)[..., :2] * px_per_metre + pelvis_moves
            fitted = moved
    return fitted, placed


def _deepened(keypoints: Keypoints, points_3d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Skeletons moved towards the landmarks' depths."""
    assert keypoints.limb_scores is not None
    offsets = keypoints.limb_offsets(points_3d)
    shares = np.repeat(DEPTH_SHARE * keypoints.limb_scores[None], len(points_3d), axis=0)
    near = np.exp(-(offsets**2).sum(axis=-1) / (2 * SPREAD_M**2))
    shares[1:] *= near[1:]
    moved = points_3d.copy()
    moved[:, _LIMB_ROWS] += shares[..., None] * offsets
    return moved


def _assigned(keypoints: Keypoints, exchanged: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows ``(M, P)`` of each skeleton's points that the keypoints are about.

    Left and right are exchanged where that is likelier, but not of the first skeleton where
    landmarks come with their depth, since it follows them.
    """
    rows = np.where(exchanged[:, None], OTHER_SIDE[list(keypoints.rows)], keypoints.rows)
    if keypoints.limbs_3d is not None:
        rows[0] = keypoints.rows
    return rows


def _residuals(
    keypoints: Keypoints, points_normalised: NDArray[np.float64], rows: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Offsets ``(M, 24, 2)`` to the keypoints from the points in ``rows`` ``(M, P)``.

    Where landmarks come with their depth, the first skeleton follows them however far they are.
    """
    skeletons = np.arange(len(points_normalised))[:, None]
    offsets = keypoints.positions - points_normalised[skeletons, rows]
    trust = keypoints.inlier_probability(offsets)
    if keypoints.limbs_3d is not None:
        trust[0] = keypoints.scores
    residuals = np.zeros_like(points_normalised)
    residuals[skeletons, rows] = trust[..., None] * offsets
    return residuals
