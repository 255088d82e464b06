"""The facing of skeletons, and a choice of hypotheses that face both ways.

A silhouette fits a pose and its reflection in depth equally well, and landmarks may be wrong in
depth.
"""

import numpy as np
from numpy.typing import NDArray

from index.skeleton import side_rows

_CORNERS = np.array([side_rows("shoulder"), side_rows("hip")]).T
"""Rows ``(2, 2)``: left and right, shoulder and hip."""

HYPOTHESES_PER_OPPOSITE_FACING = 7
"""At least one in this many hypotheses faces the opposite way to the first, since landmarks may be
wrong."""


def azimuth_deg(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Azimuths ``(...)`` of the camera about shoulders and hips of skeletons ``(..., 24, 3)``.

    In degrees from -180 to 180: 0 in front, 90 on the person's left. They do not depend on the
    direction of the trunk in the picture, since people lying down may face the camera as well.
    Skeletons are in camera axes.
    """
    corners = np.asarray(points_3d[..., _CORNERS, :], np.float64)
    across = (corners[..., 0, :, :] - corners[..., 1, :, :]).sum(axis=-2)
    trunk = (corners[..., 0, :] - corners[..., 1, :]).sum(axis=-2)
    length = np.maximum(np.hypot(trunk[..., 0], trunk[..., 1]), 1e-9)
    # Component to the right of the trunk, if the trunk points up.
    aside = (trunk[..., 0] * across[..., 1] - trunk[..., 1] * across[..., 0]) / length
    return np.rad2deg(np.arctan2(-across[..., 2], aside))


def faces_camera(azimuths_deg: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the camera is in front of the person, for each azimuth."""
    return np.cos(np.deg2rad(azimuths_deg)) > 0


def front_share(azimuths_deg: NDArray[np.float64], confidences: NDArray[np.float64]) -> float:
    """Share of the hypotheses' total confidence that faces the camera; arrays are ``(N,)``."""
    weights = confidences + 1e-9  # Equal weights if all confidences are 0.
    return float(np.clip(weights[faces_camera(azimuths_deg)].sum() / weights.sum(), 0, 1))


def likeliest_of_both_facings(
    azimuths_deg: NDArray[np.float64],
    confidences: NDArray[np.float64],
    front_probability: float,
    count: int,
) -> list[int]:
    """Choose ``count`` rows of hypotheses, with each facing as frequent as it is likely.

    The likeliest is among them, and so is one in :data:`HYPOTHESES_PER_OPPOSITE_FACING` that faces
    the opposite way, however unlikely it is, as long as there are any. Rows come in the order of
    their confidences.
    """
    order: list[int] = np.argsort(-confidences, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    opposite = front != front[order[0]]
    share = 1 - front_probability if front[order[0]] else front_probability
    share = max(share, 1 / HYPOTHESES_PER_OPPOSITE_FACING)
    wanted = min(int(share * count + 1e-9), count - 1)  # Seven sevenths are one.
    away = [row for row in order if opposite[row]][:wanted]
    others = [row for row in order if row not in away][: max(0, count - len(away))]
    return [row for row in order if row in away or row in others]
