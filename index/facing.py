"""The facing of skeletons, and a choice of hypotheses that face both ways.

A silhouette fits a pose and its reflection in depth equally well, and landmarks may be wrong in
depth.
"""

from collections.abc import Sequence

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
    return float(heading_shares(np.zeros(1), azimuths_deg, confidences)[0])


def heading_shares(
    azimuths_deg: NDArray[np.float64],
    voters_deg: NDArray[np.float64],
    confidences: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Share ``(N,)`` of the voters' confidence that lies within a right angle of each heading.

    Seen from the side, a body turned slightly towards the camera and one turned slightly away
    agree; seen from the front, a body and its reflection in depth do not. The voters are given by
    the azimuths and confidences ``(M,)`` of the hypotheses that decide.
    """
    weights = confidences + 1e-9  # Equal weights if all confidences are 0.
    agree = faces_camera(azimuths_deg[:, None] - voters_deg)
    return np.clip(agree @ weights / weights.sum(), 0, 1)


def nearest_of_both_facings(
    azimuths_deg: NDArray[np.float64],
    distances: NDArray[np.float64],
    front_probability: float,
    pools: Sequence[int],
) -> list[int]:
    """Choose rows of hypotheses, nearest first, with each facing as frequent as it is likely.

    The nearest is first. Among the first k, the share that faces the opposite way equals the
    probability of that facing. It is at least one in :data:`HYPOTHESES_PER_OPPOSITE_FACING`,
    however far these hypotheses are, as long as there are any.

    For each hypothesis to choose, ``pools`` has the number of leading rows to choose from. The
    numbers ascend, and each leaves at least one row to choose.
    """
    order: list[int] = np.argsort(distances, kind="stable").tolist()
    front = faces_camera(azimuths_deg)
    first = next(i for i in order if i < pools[0])
    opposite = front != front[first]
    share = 1 - front_probability if front[first] else front_probability
    share = max(share, 1 / HYPOTHESES_PER_OPPOSITE_FACING)
    chosen = [first]
    for pool in pools[1:]:
        near = [i for i in order if i < pool and i not in chosen]
        others = [i for i in near if opposite[i]]
        wanted = int(share * (len(chosen) + 1) + 1e-9)  # Seven sevenths are one.
        chosen.append(others[0] if others and opposite[chosen].sum() < wanted else near[0])
    return chosen
