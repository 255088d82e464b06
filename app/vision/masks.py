"""Masks: a caller's labels of bodies, or an error that says what the image shows instead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from app.vision.geometry import Box
from app.vision.images import (
    ImageError,
    bits_of,
    decode_pixels,
    is_lossy,
    read_header,
    read_stored,
    turn_of,
)

Labels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class LabelImage:
    """Where people are: 0 is background, k is person k.

    Parameters
    ----------
    labels : (H, W) array of uint8 or uint16
    present : list of int
        The labels it holds, ascending, without 0.
    left, top : int
        First column and row of the part.
    part : (h, w) array
        The smallest part that holds all labels, since most of a mask is background.
    """

    labels: Labels
    present: list[int]
    left: int
    top: int
    part: Labels

    @classmethod
    def of(cls, labels: Labels) -> LabelImage:
        if labels.ndim != 2:
            raise ValueError(f"expected labels of shape (H, W), got {labels.shape}")
        # `boundingRect` takes 8 bits only.
        marked = labels if labels.dtype == np.uint8 else np.asarray(labels != 0).view(np.uint8)
        left, top, width, height = cv2.boundingRect(marked)
        part = labels[top : top + height, left : left + width].copy()
        present = (np.flatnonzero(_counts(part)[1:]) + 1).tolist()
        return cls(labels, present, left, top, part)

    @cached_property
    def boxes(self) -> list[Box]:
        found = []
        for label in self.present:
            left, top, width, height = cv2.boundingRect(cv2.inRange(self.part, label, label))
            found.append(Box(self.left + left - 0.5, self.top + top - 0.5, width, height))
        return found

    def merged(self) -> LabelImage:
        labels, part = ((image != 0).view(np.uint8) for image in (self.labels, self.part))
        return LabelImage(labels, [1] if self.present else [], self.left, self.top, part)


def decode_mask(
    data: bytes, *, max_pixels: int, checkpoint: Callable[[], None] = lambda: None
) -> LabelImage:
    """Decode a label image: 0 is background, k is person k.

    Grey images and PNG images with a palette keep their stored values, whatever their bit depth; a
    palette gives its indices, not its colours. An image with only two values, 0 and one other,
    marks one person (label 1). So does an image with soft edges, and a lossy image (JPEG, WebP),
    since compression destroys labels; in these, values of at least half of the largest mark the
    person. Three channels are accepted if they are equal. Transparent pixels are background; if all
    others have one colour, the alpha channel marks one person. The EXIF orientation is applied.
    Parts smaller than a figure, such as a stray pixel, are dropped. ``checkpoint`` is that of
    :func:`app.vision.images.decode_image`.

    Raises
    ------
    ImageTooLargeError, ImageError
        As for :func:`app.vision.images.decode_image`, or if the image is coloured, or its values
        are no labels of bodies: shades, more than 100 labels, scattered ones, background that is
        not 0, or figures of a few pixels.
    """
    data, header = read_header(data, max_pixels)
    with turn_of(header.width * header.height, checkpoint):
        lossy = is_lossy(header, data)
        return _checked(_values(data, header, lossy), lossy)


def mask_of(values: NDArray[np.bool_] | NDArray[np.integer]) -> LabelImage:
    """The same of an array ``(H, W)`` of booleans or whole numbers."""
    if values.dtype not in (np.uint8, np.uint16):
        if values.min() < 0 or values.max() > _MAX_LABEL:
            got = f"{values.min()} to {values.max()}"
            raise ImageError(f"expected labels from 0 to {_MAX_LABEL}, got {got}")
        values = values.astype(np.uint16)
    return _checked(np.array(values), lossy=False)


_MAX_LABEL = 2**16 - 1


def _checked(labels: Labels, lossy: bool) -> LabelImage:
    image = LabelImage.of(labels)
    if image.present:
        image = _labels_of_bodies(image, lossy)
    _check_scatter(image)
    return _of_figures(image)


def _values(data: bytes, header: Image.Image, lossy: bool) -> Labels:
    """The values of a mask, or its alpha channel if everything visible has one colour."""
    rgba = read_stored(data, "RGBA") if header.has_transparency_data else None
    if rgba is not None:
        alpha = np.ascontiguousarray(rgba[..., 3])
        first = rgba[np.unravel_index(alpha.argmax(), alpha.shape)][:3].tolist()
        other = cv2.bitwise_not(cv2.inRange(rgba, (*first, 0), (*first, 255)))
        if alpha.any() and not alpha.all() and not cv2.bitwise_and(other, alpha).any():
            return alpha
    if header.format == "PNG" and header.mode == "P":
        return read_stored(data)
    pixels = decode_pixels(data, header, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if rgba is not None:
        pixels[alpha == 0] = 0
    # Channels of a lossy grey image differ by up to this.
    values = _one_channel(pixels, 16 if lossy else 0)
    if header.mode == "L":
        # 2 and 4 bits are stretched to 0..255.
        values = values // {2: 85, 4: 17}.get(bits_of(header, data), 1)
    return values


def _one_channel(pixels: NDArray[Any], max_difference: int) -> Labels:
    """Values ``(H, W)`` of an image of one channel, or of three that differ by no more."""
    if pixels.ndim == 2:
        return pixels
    first, *others = (pixels[..., channel] for channel in range(pixels.shape[2]))
    if any(cv2.absdiff(first, other).max() > max_difference for other in others):
        raise ImageError("expected a mask of one channel or of equal ones, got a coloured one")
    return np.ascontiguousarray(first)


# Share of a label's pixels whose neighbours all have the same label, if it is three pixels wide;
# narrower ones may be edges. At least this share of an edge lies beside a higher label.
_THIRD = 1 / 3


@dataclass(frozen=True)
class _Shapes:
    """How the labels of an image lie: arrays by label.

    ``cores`` and ``rising`` are shares of a label's pixels, those inside it and those beside a
    higher label; ``exposed`` is the number of those at the background.
    """

    present: list[int]
    cores: NDArray[np.float64]
    rising: NDArray[np.float64]
    exposed: NDArray[np.float64]

    @classmethod
    def of(cls, image: LabelImage) -> _Shapes:
        (rows, columns), (top, left) = image.part.shape, (image.top, image.left)
        within = slice(max(0, top - 1), top + rows + 1), slice(max(0, left - 1), left + columns + 1)
        labels, box = image.labels[within], np.ones((3, 3), np.uint8)
        lowest, highest = cv2.erode(labels, box), cv2.dilate(labels, box)
        cores, rising, exposed = (
            _counts(labels, image.present[-1] + 1, np.asarray(where).view(np.uint8))[image.present]
            for where in (lowest == highest, highest > labels, lowest == 0)
        )
        areas = _counts(image.part)[image.present]
        return cls(image.present, cores / areas, rising / areas, exposed)

    @property
    def rim(self) -> int | None:
        """Row of the label that surrounds all others and is thinner, if there is one."""
        widest = int(self.exposed.argmax())
        # Of the pixels at the background, if one label keeps the others from it.
        surrounds = self.exposed[widest] >= 0.9 * self.exposed.sum()
        return widest if surrounds and self.cores[widest] < self.cores.max() else None


def _labels_of_bodies(image: LabelImage, lossy: bool) -> LabelImage:
    """The labels without those of edges: of a void around bodies, or of shades at a single body."""
    if lossy or len(image.present) > 1:
        shapes = _Shapes.of(image)
        if not lossy and shapes.rim == len(image.present) - 1:
            # PASCAL VOC's void (255) around every object.
            return LabelImage.of(np.where(image.labels == image.present[-1], 0, image.labels))
        if lossy or _has_soft_edges(shapes):
            return LabelImage.of(_thresholded(image, lossy))
    return image


def _has_soft_edges(shapes: _Shapes) -> bool:
    """Whether most labels are the shades of soft edges; an error for those of several bodies."""
    present = shapes.present
    edges = (shapes.cores < _THIRD) & (shapes.rising >= _THIRD)
    bodies = np.array(present)[~edges]
    if shapes.rim == 0:  # One shade around a body may be wide.
        bodies = np.array(present[-1:])
    elif np.count_nonzero(edges) < max(1, len(bodies)):
        return False
    if (bodies < _CERTAIN_SHARE * present[-1]).any():
        raise ImageError(_SOFT_EDGES.format(len(present)))
    return True


def _counts(
    labels: Labels, bins: int | None = None, where: NDArray[np.uint8] | None = None
) -> NDArray[Any]:
    """How often each value occurs in an array ``(h, w)``."""
    if labels.size == 0:
        return np.zeros(bins or 1, np.float32)
    # calcHist is several times as fast as np.unique or np.bincount.
    bins = bins or int(labels.max()) + 1
    return cv2.calcHist([labels], [0], where, [bins], [0, bins])[:, 0]


# A value counts as white from this share of the largest value, and as black up to the rest of it:
# lossy compression and resizing move values by less, except at edges.
_CERTAIN_SHARE = 0.81

_SOFT_EDGES = (
    "expected a mask of labels that mark bodies, got {} values: a mask with soft edges must be "
    "thresholded first"
)


def _thresholded(image: LabelImage, lossy: bool) -> NDArray[np.uint8]:
    """The person ``(H, W)`` of a mask with shades; an error if its values look like labels."""
    values, peak = image.labels, 255 if lossy else image.present[-1]
    marked = np.asarray(values > (peak - 1) // 2).view(np.uint8)
    certain = round(_CERTAIN_SHARE * peak)
    between = np.count_nonzero((values > peak - certain) & (values < certain))
    count = np.count_nonzero(marked)  # 0 if labels are small numbers.
    if count and between <= 0.75 * count:
        return marked
    if lossy:
        raise ImageError(
            "expected a mask of black and white, since lossy compression (JPEG, WebP) keeps no "
            "labels, got one of other values; send labels as PNG"
        )
    raise ImageError(_SOFT_EDGES.format(len(image.present)))


def _check_scatter(image: LabelImage) -> None:
    part = image.part
    changes = sum(
        np.count_nonzero(first != second)
        for first, second in ((part[:, 1:], part[:, :-1]), (part[1:], part[:-1]))
    )
    # Fifty people filling a frame of 12 megapixels give 400,000 pairs, a thirtieth of the pixels;
    # noise gives two pairs for each pixel.
    most = min(1_000_000, max(10_000, part.size // 2))
    if changes > most:
        raise ImageError(
            "expected a mask whose labels mark people, got scattered ones: "
            f"{changes} neighbouring pixels differ, more than {most}"
        )


# Longer side of the smallest figure: below it, a third of the clear postures of rendered people
# change.
_MIN_FIGURE_PX = 12


def _of_figures(image: LabelImage) -> LabelImage:
    """The labels without specks; a single label becomes label 1."""
    labels = image.labels
    for label, box in zip(image.present, image.boxes, strict=True):
        left, top, right, bottom = box.pixels()
        marked = labels[top:bottom, left:right] == label
        figure = _without_specks(marked)
        if figure is not marked:
            labels = labels.copy() if labels is image.labels else labels
            labels[top:bottom, left:right][marked & ~figure] = 0
    figures = image if labels is image.labels else LabelImage.of(labels)
    if image.present and not figures.present:
        raise ImageError(
            f"expected a mask of figures at least {_MIN_FIGURE_PX} pixels high or wide, "
            "got smaller ones"
        )
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    # Largest share of the frame's border that people cover.
    if np.count_nonzero(border) >= 0.75 * border.size:
        found = ", ".join(map(str, np.unique(border[border > 0])[:5].tolist()))
        raise ImageError(
            f"expected a mask whose background is 0, got labels {found} along the frame's border: "
            "the mask may be inverted, or label walls and floors"
        )
    return figures.merged() if len(figures.present) == 1 and figures.present != [1] else figures


def _without_specks(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8))
    parts = stats[1:]
    is_large = parts[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) >= _MIN_FIGURE_PX
    areas = parts[:, cv2.CC_STAT_AREA]
    # Smaller parts, also relative to the largest, are specks.
    keep = is_large | ((areas >= 0.05 * areas.max()) & is_large.any())
    return mask if keep.all() else np.append(False, keep)[labels]


MIN_FILL = 0.12
"""Share of a box that a silhouette fills, below which nobody was cut out."""


def cleaned(mask: NDArray[np.bool_], *, max_hole: float) -> NDArray[np.bool_]:
    """A body's mask ``(H, W)`` without small parts, and without holes of up to a share of it.

    A lamp post may separate a leg from the body. Larger holes stay: the gap between arm and trunk
    shows the pose.
    """
    return _fill_small_holes(_keep_components(mask), max_hole)


def _keep_components(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    if _parts_and_holes(mask)[0] < 2:
        return mask
    _, labels, stats, _ = cv2.connectedComponentsWithStats(np.asarray(mask).view(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    # Area of a part of a body, relative to the largest part.
    keep = areas >= 0.1 * areas.max()
    keep[0] = False
    keep[areas.argmax()] = True
    return keep[labels]


def _fill_small_holes(mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    if not _parts_and_holes(mask)[1]:
        return mask
    limit = share * np.count_nonzero(mask)
    # A ring of background makes the outside one component, number `labels[0, 0]`.
    background = np.pad(~mask, 1, constant_values=True).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(background, connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] <= limit
    small[0] = False  # The mask itself.
    small[labels[0, 0]] = False
    return mask | small[labels[1:-1, 1:-1]]


def _parts_and_holes(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """Number of components of a mask, and of holes in them; counted in a tenth of the time."""
    simple = cv2.CHAIN_APPROX_SIMPLE
    _, tree = cv2.findContours(np.asarray(mask).view(np.uint8), cv2.RETR_CCOMP, simple)
    parents = np.empty(0) if tree is None else tree[0, :, 3]
    return int((parents < 0).sum()), int((parents >= 0).sum())
