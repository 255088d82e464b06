"""Tidying binary masks and snapping soft ones to the photograph's edges."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def fill_small_holes(mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Fill holes smaller than ``share`` of the mask's area.

    Larger ones stay: the gap between an arm and the trunk says much about the pose.

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


def guided_filter(
    guide: NDArray[np.uint8],
    values: NDArray[np.float32],
    radius: int,
    smoothness: float = 1e-3,
) -> NDArray[np.float32]:
    """Smooth ``values`` where the photograph is smooth and keep its edges where it has them.

    Inside every window the result is an affine function of the guide's three channels [1]_.

    Parameters
    ----------
    guide : (H, W, 3) uint8 array
        The photograph.
    values : (H, W) float32 array
        A soft mask, 0 to 1.
    radius : int
        Of the square window, in pixels.
    smoothness : float
        Variance (of channels in 0..1) below which the guide counts as smooth.

    Returns
    -------
    (H, W) float32 array

    References
    ----------
    .. [1] K. He, J. Sun, X. Tang, "Guided image filtering", ECCV 2010.
    """
    size = (2 * radius + 1, 2 * radius + 1)
    image = guide.astype(np.float32) / np.float32(255)

    def mean(array: NDArray[Any]) -> NDArray[np.float32]:
        return np.asarray(cv2.blur(array, size), np.float32)

    image_mean, value_mean = mean(image), mean(values)
    covariance = mean(image * values[..., None]) - image_mean * value_mean[..., None]
    pairs = mean(image[..., [0, 0, 0]] * image)
    others = mean(image[..., [1, 1, 2]] * image[..., [1, 2, 2]])
    # The symmetric matrix (a b c; b d e; c e f) of every window, inverted by its adjugate.
    a, b, c = (pairs[..., i] - image_mean[..., 0] * image_mean[..., i] for i in range(3))
    d, e, f = (
        others[..., k] - image_mean[..., i] * image_mean[..., j]
        for k, (i, j) in enumerate(((1, 1), (1, 2), (2, 2)))
    )
    a, d, f = a + smoothness, d + smoothness, f + smoothness
    adjugate = np.empty((*values.shape, 3, 3), np.float32)
    adjugate[..., 0, 0] = d * f - e * e
    adjugate[..., 0, 1] = adjugate[..., 1, 0] = c * e - b * f
    adjugate[..., 0, 2] = adjugate[..., 2, 0] = b * e - c * d
    adjugate[..., 1, 1] = a * f - c * c
    adjugate[..., 1, 2] = adjugate[..., 2, 1] = b * c - a * e
    adjugate[..., 2, 2] = a * d - b * b
    determinant = a * adjugate[..., 0, 0] + b * adjugate[..., 0, 1] + c * adjugate[..., 0, 2]
    slope = np.einsum("...ij,...j->...i", adjugate, covariance) / determinant[..., None]
    offset = value_mean - (slope * image_mean).sum(axis=-1)
    return np.asarray((mean(slope) * image).sum(axis=-1) + mean(offset), np.float32)
