"""Which way a person faces, from skeletons and from weighted hypotheses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from index.skeleton import side_rows

FacingSource = Literal["image", "motion", "none"]

_CORNERS = np.array([side_rows("shoulder"), side_rows("hip")]).T
"""Rows ``(2, 2)``: left and right, shoulder and hip."""


@dataclass(frozen=True)
class Facing:
    """How likely it is that the camera sees a person from the front.

    Parameters
    ----------
    evidence : str
        ``image``: the photograph; ``motion``: the direction of walking; ``none``: only the
        hypotheses themselves.
    """

    front_probability: float
    evidence: FacingSource


def azimuth_deg(points_3d: NDArray[np.floating]) -> NDArray[np.float64]:
    """Azimuth of the camera about shoulders and hips: 0 in front, 90 on the person's left.

    It does not depend on the direction of the trunk in the picture, since people lying down may
    face the camera as well.

    Parameters
    ----------
    points_3d : (..., 24, 3) array
        Camera axes; rows are ``POINT_NAMES``.

    Returns
    -------
    (...) float64 array
        Degrees from -180 to 180.
    """
    corners = np.asarray(points_3d[..., _CORNERS, :], np.float64)
    across = (corners[..., 0, :, :] - corners[..., 1, :, :]).sum(axis=-2)
    trunk = (corners[..., 0, :] - corners[..., 1, :]).sum(axis=-2)
    length = np.maximum(np.hypot(trunk[..., 0], trunk[..., 1]), 1e-9)
    # Component to the right of the trunk, if the trunk points up.
    aside = (trunk[..., 0] * across[..., 1] - trunk[..., 1] * across[..., 0]) / length
    return np.asarray(np.rad2deg(np.arctan2(-across[..., 2], aside)))


def faces_camera(azimuths_deg: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the camera is in front of the person, for each azimuth."""
    return np.asarray(np.cos(np.deg2rad(azimuths_deg)) > 0)


def front_share(azimuths_deg: NDArray[np.float64], confidences: NDArray[np.float64]) -> float:
    """Share of the hypotheses' total confidence that faces the camera; arrays are ``(N,)``."""
    return float(heading_shares(np.zeros(1), azimuths_deg, confidences)[0])


def heading_shares(
    azimuths_deg: NDArray[np.float64],
    voters_deg: NDArray[np.float64],
    confidences: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Share of the voters' confidence that lies within a right angle of each heading.

    Seen from the side, a body turned slightly towards the camera and one turned slightly away
    agree; seen from the front, a body and its reflection in depth do not.

    Parameters
    ----------
    azimuths_deg : (N,) float64 array
    voters_deg, confidences : (M,) float64 array
        Azimuths and confidences of the hypotheses that decide.

    Returns
    -------
    (N,) float64 array
    """
    weights = confidences + 1e-9  # Equal weights if all confidences are 0.
    agree = faces_camera(azimuths_deg[:, None] - voters_deg)
    return np.asarray(np.clip(agree @ weights / weights.sum(), 0, 1))
