"""Recorded poses laid on the ground, on the back, the belly, a side, or anything between.

Hardly any motion capture shows people who lie; limbs are held alike by many who stand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from index.build.body import about_vertical, turned_to_front

SIDES = ("back", "left", "belly", "right")
"""What somebody lies on, by quarters of the turn about the body's long axis."""

TRUNK_BELOW_M = 0.3
"""Pelvis and chest of a body that lies are no higher than this above its lowest joint."""


def laid_down(
    rotations: NDArray[np.float64], lying_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Lay bodies down.

    Parameters
    ----------
    rotations : (P, B, 3, 3) float64 array
        World rotations of the bones, the pelvis facing +z.
    lying_deg : (P,) float64 array
        Turn about the long axis before the body is laid on its back: 90 lies on the left side,
        180 on the belly. NaN leaves a pose as it is.

    Returns
    -------
    (P, B, 3, 3) float64 array
        The pelvis faces +z again, as far as it faces anywhere.
    """
    about_long_axis = about_vertical(np.deg2rad(np.nan_to_num(lying_deg)))
    # From upright to the back: what was up points backwards, what was ahead points up.
    onto_back = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    lying = turned_to_front((onto_back @ about_long_axis)[:, None] @ rotations)
    return np.where(np.isnan(lying_deg)[:, None, None, None], rotations, lying)


def side_of(lying_deg: float) -> str:
    """What a body laid down lies on, one of :data:`SIDES`."""
    return SIDES[int(np.rint(lying_deg / 90.0)) % 4]
