"""Faults of silhouettes cut out of photographs, which simulated ones lack.

Outlines are ragged and a little too wide, gaps between the limbs are filled, background sticks to
the body, and hands, feet and heads are cut off. The shares and sizes below are those of the
service's own silhouettes beside the true ones, on street photographs and indoors.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, Placement, normalise
from index.skeleton import JOINT_NAMES

_ENDS = tuple(
    JOINT_NAMES.index(name)
    for name in ("left_wrist", "right_wrist", "left_wrist", "right_wrist",
                 "left_elbow", "right_elbow", "left_toe", "right_toe", "head")
)  # fmt: skip
_TRUNK = tuple(JOINT_NAMES.index(name) for name in ("pelvis", "spine", "chest", "neck"))
_TRUNK_WIDTH_SHARE = 0.12
# Pixels around the silhouette for an outline that moves outwards.
_MARGIN_PX = 8
# Length of an error along the outline (one standard deviation).
_GRAIN_PX = 3.5
# Range of the standard deviation of the shift across the outline of an upright person.
_OUTLINE_STD_PX = (0.6, 2.4)
# Mean distance of the outline outside the body's.
_WIDER_PX = 0.4
# Shares of silhouettes with filled gaps or background, and of those that lack a part.
_EXTRA_SHARE, _MISSING_SHARE = 0.4, 0.3
# Range of the radius of a filled gap.
_GAP_PX = (3, 8)
# Range of the area of background that sticks to the body, as a share of the body's.
_BLOB_SHARE = (0.02, 0.12)
# Range of the radius that is cut off around a hand, a foot or the head, as a share of the height of
# the frame.
_CUT_SHARE = (0.03, 0.09)


def degrade(
    silhouette: NDArray[np.uint8], joints: NDArray[np.floating], generator: np.random.Generator
) -> tuple[NDArray[np.uint8], Placement]:
    """Make a normalised silhouette look as if it had been cut out of a photograph.

    ``joints`` ``(19, 2)`` are positions in it. The result is normalised again; its placement leads
    from the old normalised frame to the new one, which shifts where parts were lost.
    """
    padded = np.pad(silhouette, _MARGIN_PX)
    places = np.asarray(joints, np.float64) + _MARGIN_PX
    # Beyond its bounding box nothing sticks to a person: that is where the detector's box ends.
    box = tuple(cv2.boundingRect(padded))
    if generator.random() < _EXTRA_SHARE:
        padded = _with_extra(padded, box, generator)
    if generator.random() < _MISSING_SHARE:
        padded = _with_less(padded, places, box, generator)
    moved = _with_ragged_outline(padded, box[3] / HEIGHT, generator)
    kept = _largest(moved) if moved.any() else padded
    degraded, placement = normalise(kept)
    shift = placement.to_normalised([_MARGIN_PX, _MARGIN_PX])
    return degraded, Placement(placement.scale, float(shift[0]), float(shift[1]))


def _with_extra(
    mask: NDArray[np.uint8], box: tuple[int, ...], generator: np.random.Generator
) -> NDArray[np.uint8]:
    """Fill narrow gaps, or let a blob of background stick to the outline, or both."""
    kind = generator.integers(3)
    scale = box[3] / HEIGHT
    if kind != 0:
        size = 2 * max(1, round(generator.uniform(*_GAP_PX) * scale)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, disc), np.uint8)
    if kind != 1:
        rows, columns = np.nonzero(mask != cv2.erode(mask, np.ones((3, 3), np.uint8)))
        at = generator.integers(len(rows))
        area = generator.uniform(*_BLOB_SHARE) * int(mask.sum())
        stretch = generator.uniform(1.0, 2.5)
        radius = np.sqrt(area / np.pi)
        axes = (max(1, round(radius / np.sqrt(stretch))), max(1, round(radius * np.sqrt(stretch))))
        blob = np.zeros_like(mask)
        centre = (int(columns[at]), int(rows[at]))
        cv2.ellipse(blob, centre, axes, generator.uniform(-45, 45), 0, 360, 1, -1)
        inside = np.zeros_like(mask)
        x, y, width, height = box
        inside[y : y + height, x : x + width] = 1
        mask = mask | (blob & inside)
    return mask


def _with_less(
    mask: NDArray[np.uint8],
    joints: NDArray[np.float64],
    box: tuple[int, ...],
    generator: np.random.Generator,
) -> NDArray[np.uint8]:
    """Cut off what is near the end of one limb or two, or the head; the trunk stays."""
    trunk = np.zeros_like(mask)
    line = np.rint(joints[list(_TRUNK)]).astype(np.int32)
    cv2.polylines(trunk, [line], False, 1, max(1, round(_TRUNK_WIDTH_SHARE * box[3])))
    cut = np.zeros_like(mask)
    for _ in range(int(generator.integers(1, 3))):
        centre = np.rint(joints[generator.choice(_ENDS)]).astype(int).tolist()
        cv2.circle(cut, centre, max(1, round(generator.uniform(*_CUT_SHARE) * box[3])), 1, -1)
    less = mask & ~(cut & ~trunk)
    return less if less.any() else mask


def _with_ragged_outline(
    mask: NDArray[np.uint8], scale: float, generator: np.random.Generator
) -> NDArray[np.uint8]:
    """Move the outline in and out at random, on average a little out."""
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3)
    white = generator.standard_normal(mask.shape, np.float32)
    grain = cv2.GaussianBlur(white, (0, 0), _GRAIN_PX)
    shift = grain * (generator.uniform(*_OUTLINE_STD_PX) / float(grain.std())) + _WIDER_PX
    return (inside - outside + scale * shift > 0).astype(np.uint8)


def _largest(mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The largest connected part of a mask that is not empty."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    return labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())


def degrade_all(
    silhouettes: NDArray[np.uint8], joints: NDArray[np.floating], generator: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Degrade silhouettes ``(B, 128, 48)``; return them with their joints ``(B, 19, 2)``."""
    degraded = np.empty_like(silhouettes)
    moved = np.empty(joints.shape)
    for row, (silhouette, places) in enumerate(zip(silhouettes, joints, strict=True)):
        degraded[row], placement = degrade(silhouette, places, generator)
        moved[row] = placement.to_normalised(places)
    return degraded, moved
