"""Tidying binary masks."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def fill_small_holes(mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Fill holes smaller than ``share`` of the mask's area.

    Larger ones stay: the gap between an arm and the trunk tells the pose.

    Parameters
    ----------
    mask : (H, W) bool array
    share : float
        0 fills nothing, 1 everything that is enclosed.

    Returns
    -------
    (H, W) bool array
    """
    limit = share * np.count_nonzero(mask)
    # A ring of background, so that the outside is one component, number `labels[0, 0]`.
    background = np.pad(~mask, 1, constant_values=True).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(background, connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] <= limit
    small[0] = False  # the mask itself
    small[labels[0, 0]] = False
    if count <= 2 or not small.any():
        return mask
    return np.asarray(mask | small[labels[1:-1, 1:-1]])


def keep_components(mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Keep the largest connected part and those of at least ``share`` of its area.

    A lamp post may part a leg from its body, so one part need not be all.

    Parameters
    ----------
    mask : (H, W) bool array
    share : float
        1 keeps the largest part alone.

    Returns
    -------
    (H, W) bool array
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count <= 2:
        return mask
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    keep = areas >= share * areas.max()
    keep[0] = False
    keep[areas.argmax()] = True
    return np.asarray(keep[labels])
