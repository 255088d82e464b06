"""Normalisation of a silhouette to 128x48 and its inverse transform."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

HEIGHT = 128
WIDTH = 48

# Silhouettes whose longer side is twice this or more are averaged over blocks before they are
# resampled: for a mask a million pixels wide the resampling matrices alone would take 512 MB.
_AXIS_PX = 512
"""Longer side above which the principal axis is that of block means."""

_LARGEST_PX = 1024

INSIDE = 0.4999
"""Coverage from which a pixel is the person's, as a share of that of the most covered pixel.

It is relative, so that a mask too thin to cover half of any pixel is not lost. It is a little below
a half, since many pixels are covered by exactly half and rounding differs between processors.
"""


@dataclass(frozen=True)
class Placement:
    """Transform from an image to the normalised frame: a scale and a shift.

    ``normalised = scale * image + offset``, in pixels on both sides, each with its
    origin at the centre of the top-left pixel.

    Parameters
    ----------
    scale : float
        Normalised pixels per image pixel; positive.
    offset_x, offset_y : float
        Shift in normalised pixels.
    """

    scale: float
    offset_x: float
    offset_y: float

    def __post_init__(self) -> None:
        if not (np.isfinite([self.scale, self.offset_x, self.offset_y]).all() and self.scale > 0):
            raise ValueError(f"expected a positive scale and finite offsets, got {self}")

    def to_normalised(self, points: ArrayLike) -> NDArray[np.float64]:
        """Image pixels to normalised pixels, both ``(..., 2)`` with x before y."""
        return np.asarray(points, np.float64) * self.scale + (self.offset_x, self.offset_y)


def normalise(mask: NDArray[np.generic]) -> tuple[NDArray[np.uint8], Placement]:
    """Scale a silhouette to fill a frame of 128x48, centred, keeping its aspect ratio.

    The tight bounding box of the mask touches the frame at top and bottom, or at left
    and right where it is wider than 48/128 of its height.

    Parameters
    ----------
    mask : (H, W) array of bool or numbers
        Non-zero on the person.

    Returns
    -------
    silhouette : (128, 48) uint8 array
        1 on the person, 0 elsewhere.
    placement : Placement
        Image pixels to normalised pixels and back.

    Raises
    ------
    ValueError
        If the mask is not two-dimensional or has no pixel set.
    """
    if mask.ndim != 2:
        raise ValueError(f"expected a mask of shape (H, W), got shape {mask.shape}")
    filled = mask != 0
    left, top, width, height = bounding_box(filled)
    if height == 0:
        raise ValueError("expected a mask with at least one pixel set, got an empty one")
    bottom, right = top + height, left + width
    scale = min(HEIGHT / height, WIDTH / width)
    placement = Placement(
        float(scale),
        float((WIDTH - 1) / 2 - scale * (left + right - 1) / 2),
        float((HEIGHT - 1) / 2 - scale * (top + bottom - 1) / 2),
    )
    block = max(1, max(height, width) // _LARGEST_PX)
    crop = averaged(filled[top:bottom, left:right], block)
    vertical = _resampling_matrix(HEIGHT, crop.shape[0], scale * block)
    horizontal = _resampling_matrix(WIDTH, crop.shape[1], scale * block)
    grey = vertical @ crop @ horizontal.T
    return (grey >= INSIDE * grey.max()).astype(np.uint8), placement


def bounding_box(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, top, width and height of the tight bounding box of a mask; all 0 of an empty one."""
    left, top, width, height = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    return left, top, width, height


def averaged(crop: NDArray[np.bool_], block: int) -> NDArray[np.float32]:
    """Means of the blocks of ``block`` x ``block`` pixels, whose grid is centred on the crop.

    Pixels of a block beyond the crop are background.
    """
    if block == 1:
        return crop.astype(np.float32)
    means: NDArray[np.generic] = crop
    # The longer side comes first, since the shorter one may be padded to many times its length.
    for axis in sorted((0, 1), key=lambda axis: -crop.shape[axis]):
        missing = -means.shape[axis] % block
        margins = [(0, 0), (0, 0)]
        margins[axis] = missing // 2, missing - missing // 2
        padded = np.pad(means, margins)
        before, after = padded.shape[:axis], padded.shape[axis + 1 :]
        means = padded.reshape(*before, -1, block, *after).mean(axis + 1, dtype=np.float32)
    return np.asarray(means, np.float32)


def is_wide(mask: NDArray[np.generic]) -> bool:
    """Whether the bounding box of a mask is wider than high."""
    _, _, width, height = bounding_box(mask != 0)
    return width > height


def principal_axis_deg(mask: NDArray[np.generic]) -> float:
    """Angle of a mask's long axis from the vertical, clockwise, from -90 to 90 degrees."""
    block = max(1, max(mask.shape) // _AXIS_PX)
    grey = averaged(mask != 0, block)
    y, x = np.nonzero(grey)
    (across, both), (_, along) = np.cov(x, y, bias=True, aweights=grey[y, x] if block > 1 else None)
    from_horizontal = np.rad2deg(np.arctan2(2 * both, across - along)) / 2
    return float(from_horizontal % 180.0 - 90.0)


def _resampling_matrix(size: int, source_size: int, scale: float) -> NDArray[np.float32]:
    """Tent filter as a matrix ``(size, source_size)``: bilinear up, averaging down.

    Samples outside the crop are background, so rows at the border of the silhouette may sum to
    less than 1.
    """
    centres = (np.arange(size) - (size - 1) / 2) / scale + (source_size - 1) / 2
    support = max(1.0, 1.0 / scale)
    weights = _tents(centres, np.arange(source_size), support)
    # Rows are normalised by the sum in an unbounded source, so that the border fades to 0.
    lattice = np.arange(-int(np.ceil(support)) - 1, int(np.ceil(support)) + 2)
    total = _tents(centres - np.floor(centres), lattice, support).sum(axis=1, keepdims=True)
    return np.asarray(weights / total)


def _tents(
    centres: NDArray[np.floating], samples: NDArray[np.integer], support: float
) -> NDArray[np.float32]:
    """Tents of height 1 that fall to 0 at ``support``: a matrix ``(centres, samples)``."""
    # In single precision and in place: five times faster for a tall silhouette.
    tents = centres[:, None].astype(np.float32) - samples.astype(np.float32)
    np.abs(tents, out=tents)
    tents /= -support
    tents += 1
    return np.maximum(tents, 0, out=tents)


def pack(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pack silhouettes ``(B, 128, 48)`` of 0 and 1 into bits ``(B, 768)``, row by row."""
    return np.packbits(silhouettes.reshape(len(silhouettes), HEIGHT * WIDTH), axis=1)


def unpack(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Inverse of :func:`pack`: bits ``(B, 768)`` to silhouettes ``(B, 128, 48)``."""
    return np.unpackbits(bits, axis=1).reshape(len(bits), HEIGHT, WIDTH)
