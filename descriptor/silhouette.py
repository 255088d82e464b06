"""Silhouettes: normalised to 128x48, rotated, compared by their outlines, packed."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

HEIGHT = 128
WIDTH = 48

# Silhouettes whose longer side is twice this or more are averaged over blocks before they are
# resampled or rotated: for a mask a million pixels wide the resampling matrices alone would take
# 512 MB, and OpenCV accepts sides of at most 32,767 pixels.
_LARGEST_PX = 1024
# The same for the principal axis.
_AXIS_PX = 512
# Coverage from which a pixel is the person's, as a share of that of the most covered pixel. It is
# relative, so that a mask too thin to cover half of any pixel is not lost. It is a little below a
# half, since many pixels are covered by exactly half and rounding differs between processors.
_INSIDE = 0.4999


@dataclass(frozen=True)
class Placement:
    """Transform from an image to the normalised frame: a scale and a shift.

    ``normalised = scale * image + offset``, in pixels on both sides, each with its
    origin at the centre of the top-left pixel.
    """

    scale: float  # normalised pixels per image pixel; positive
    # Shift in normalised pixels.
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
    crop = _averaged(filled[top:bottom, left:right], block)
    vertical = _resampling_matrix(HEIGHT, crop.shape[0], scale * block)
    horizontal = _resampling_matrix(WIDTH, crop.shape[1], scale * block)
    # The columns first: there are fewer of them in the result than rows.
    grey = vertical @ (crop @ horizontal.T)
    return (grey >= _INSIDE * grey.max()).astype(np.uint8), placement


def rotate_silhouette(
    mask: NDArray[np.uint8] | NDArray[np.bool_], angle_deg: float
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Rotate a silhouette clockwise and normalise it.

    Parameters
    ----------
    mask : (H, W) uint8 or bool array
        0 is background.

    Returns
    -------
    rotated : (128, 48) uint8 array
    inverse : (2, 3) float64 array
        Affine transform from its pixels to those of ``mask``.
    """
    block = max(1, max(mask.shape) // _LARGEST_PX)
    covered = _averaged(mask != 0, block)
    height, width = covered.shape
    # Longer side of a mask while it is rotated.
    scale = 256 / max(height, width)
    sine, cosine = abs(np.sin(np.deg2rad(angle_deg))), abs(np.cos(np.deg2rad(angle_deg)))
    # The canvas holds the whole rotated mask; its sides are even.
    size = 2 * np.ceil(
        scale / 2 * np.array([width * cosine + height * sine, width * sine + height * cosine])
    )
    # Pixel p of the block means lies at scale * p + corner on the canvas.
    corner = (size - 1 - scale * np.array([width - 1, height - 1])) / 2
    # OpenCV rotates counterclockwise.
    rotation = cv2.getRotationMatrix2D(((size - 1) / 2).tolist(), -angle_deg, 1.0)
    to_canvas = np.column_stack(
        [scale * rotation[:, :2], rotation[:, :2] @ corner + rotation[:, 2]]
    )
    canvas = cv2.warpAffine(covered, to_canvas, size.astype(int).tolist())
    rotated, placement = normalise(canvas >= _INSIDE * canvas.max())
    offset = np.array([placement.offset_x, placement.offset_y])
    from_canvas = cv2.invertAffineTransform(to_canvas)
    linear = from_canvas[:, :2] / placement.scale
    inverse = np.column_stack([linear, from_canvas[:, 2] - linear @ offset])
    # Blocks and mask share their centre.
    inverse[:, 2] -= (np.array([width, height]) - 1) / 2
    inverse *= block
    inverse[:, 2] += (np.array([mask.shape[1], mask.shape[0]]) - 1) / 2
    return rotated, inverse


def bounding_box(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, top, width and height of the tight bounding box of a mask; all 0 of an empty one."""
    left, top, width, height = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    return left, top, width, height


def is_wide(mask: NDArray[np.generic]) -> bool:
    """Whether the bounding box of a mask is wider than high."""
    _, _, width, height = bounding_box(mask != 0)
    return width > height


def principal_axis_deg(mask: NDArray[np.generic]) -> float:
    """Angle of a mask's long axis from the vertical, clockwise, from -90 to 90 degrees."""
    block = max(1, max(mask.shape) // _AXIS_PX)
    grey = _averaged(mask != 0, block)
    y, x = np.nonzero(grey)
    (across, both), (_, along) = np.cov(x, y, bias=True, aweights=grey[y, x] if block > 1 else None)
    from_horizontal = np.rad2deg(np.arctan2(2 * both, across - along)) / 2
    return float(from_horizontal % 180.0 - 90.0)


def outline_distances(
    silhouette: NDArray[np.uint8], others: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """Mean distance from each outline to the nearest point of the other, averaged both ways.

    Pixels ``(B,)`` between a silhouette ``(128, 48)`` and others ``(B, 128, 48)``.
    """
    silhouettes = np.concatenate([silhouette[None], others])
    # Shortest paths between two pixels stay within the bounding box of all silhouettes.
    left, top, width, height = cv2.boundingRect(silhouettes.max(axis=0))
    outlines = _outlines(silhouettes[:, top : top + max(1, height), left : left + max(1, width)])
    # Sums of float32 would depend on how many others there are, and on the processor.
    distances = _distance_transforms(outlines).reshape(len(outlines), -1).astype(np.float64)
    on_outline = outlines.reshape(len(outlines), -1).astype(np.float64)
    lengths = np.maximum(on_outline.sum(axis=1), 1)
    from_others = on_outline[1:] @ distances[0] / lengths[1:]
    to_others = distances[1:] @ on_outline[0] / lengths[0]
    return (from_others + to_others) / 2


def pack(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pack silhouettes ``(B, 128, 48)`` of 0 and 1 into bits ``(B, 768)``, row by row."""
    return np.packbits(silhouettes.reshape(len(silhouettes), HEIGHT * WIDTH), axis=1)


def unpack(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Inverse of :func:`pack`: bits ``(B, 768)`` to silhouettes ``(B, 128, 48)``."""
    return np.unpackbits(bits, axis=1).reshape(len(bits), HEIGHT, WIDTH)


def _resampling_matrix(size: int, source_size: int, scale: float) -> NDArray[np.float32]:
    """Tent filter as a matrix ``(size, source_size)``: bilinear up, averaging down.

    Samples outside the crop are background, so rows at the border may sum to less than 1.
    """
    centres = (np.arange(size) - (size - 1) / 2) / scale + (source_size - 1) / 2
    support = max(1.0, 1.0 / scale)
    weights = _tents(centres, np.arange(source_size), support)
    # Rows are normalised by the sum in an unbounded source, so that the border fades to 0.
    lattice = np.arange(-int(np.ceil(support)) - 1, int(np.ceil(support)) + 2)
    total = _tents(centres - np.floor(centres), lattice, support).sum(axis=1, keepdims=True)
    return weights / total


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


def _averaged(crop: NDArray[np.bool_], block: int) -> NDArray[np.float32]:
    """Means of the blocks of ``block`` x ``block`` pixels, whose grid is centred on the crop."""
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


def _outlines(silhouettes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Outermost pixels of silhouettes ``(B, H, W)``, found in one tall picture."""
    count, height, width = silhouettes.shape
    # A row of background below each separates them.
    padded = np.zeros((count, height + 1, width), np.uint8)
    padded[:, :height] = silhouettes != 0
    eroded = cv2.erode(
        padded.reshape(-1, width),
        np.ones((3, 3), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).reshape(padded.shape)
    return (padded != eroded)[:, :height]


def _distance_transforms(outlines: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance ``(B, H, W)`` of each pixel to the outline; the frame's diagonal if it is empty."""
    distances = np.empty(outlines.shape, np.float32)
    for background, distance in zip((~outlines).view(np.uint8), distances, strict=True):
        cv2.distanceTransform(background, cv2.DIST_L2, 3, distance)
    distances[~outlines.any(axis=(1, 2))] = np.hypot(HEIGHT, WIDTH)
    return distances
