"""Tidying binary masks and snapping soft ones to the photograph's edges."""

from __future__ import annotations

from collections.abc import Sequence

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

    def mean(plane: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.blur(plane, size), np.float32)

    # Plane by plane: much sooner done than with the three channels of a pixel side by side.
    image = [guide[..., i] * np.float32(1 / 255) for i in range(3)]
    image_means, value_mean = [mean(plane) for plane in image], mean(values)
    covariance = [
        mean(plane * values) - plane_mean * value_mean
        for plane, plane_mean in zip(image, image_means, strict=True)
    ]
    # The symmetric matrix (a b c; b d e; c e f) of every window, inverted by its adjugate.
    a, b, c, d, e, f = (
        mean(image[i] * image[j]) - image_means[i] * image_means[j]
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    for variance in (a, d, f):
        variance += np.float32(smoothness)
    first = (d * f - e * e, c * e - b * f, b * e - c * d)
    second = (first[1], a * f - c * c, b * c - a * e)
    third = (first[2], second[2], a * d - b * b)
    determinant = _dot((a, b, c), first)
    slopes = [_dot(row, covariance) / determinant for row in (first, second, third)]
    offset = value_mean - _dot(slopes, image_means)
    return _dot([mean(slope) for slope in slopes], image) + mean(offset)


def _dot(
    some: Sequence[NDArray[np.float32]], others: Sequence[NDArray[np.float32]]
) -> NDArray[np.float32]:
    """Sum of the products of three planes each."""
    return np.asarray(some[0] * others[0] + some[1] * others[1] + some[2] * others[2], np.float32)
