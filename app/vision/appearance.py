"""The looks of a person in a frame: the colours of the clothes, and a picture of the place."""

import math
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box, crop, shrink_quickly
from app.vision.halved import HALF, Frame, seen_at
from app.vision.people import Silhouette

_HUES, _SATURATIONS, _GREYS = 8, 4, 8
# If the longer side is less than twice this, every row and column is read, otherwise every second
# one, and so on; the colours stay the same.
_COLOURS_PX = 200


def colours_of(frame: Frame, silhouette: Silhouette) -> NDArray[np.float32]:
    """Colours ``(2 * 40,)`` of the upper and lower half of a person in a frame, BGR.

    They are histograms of hue by saturation, and of brightness, for each half; they sum to 1.
    """
    pixels, scale = seen_at(frame, HALF)
    per_pixel = round(1 / scale)
    stride = max(1, max(silhouette.crop.shape) // (per_pixel * _COLOURS_PX))
    mask = silhouette.crop[:: stride * per_pixel, :: stride * per_pixel].astype(np.uint8)
    rows, columns = (
        slice(first // per_pixel, first // per_pixel + stride * count, stride)
        for first, count in zip((silhouette.top, silhouette.left), mask.shape, strict=True)
    )
    crop = cv2.cvtColor(pixels[rows, columns], cv2.COLOR_BGR2HSV)
    parts, middle = [], len(mask) / 2
    for half in (np.s_[: math.ceil(middle)], np.s_[math.floor(middle) :]):
        part, inside = crop[half], mask[half]
        colour = cv2.calcHist([part], [0, 1], inside, [_HUES, _SATURATIONS], [0, 180, 0, 256])
        grey = cv2.calcHist([part], [2], inside, [_GREYS], [0, 256])
        parts += [colour.ravel(), grey.ravel()]
    histogram = np.concatenate(parts)
    return np.asarray(histogram / max(1.0, float(histogram.sum())), np.float32)


def colour_distance(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Hellinger distance of two histograms, 0 to 1."""
    return math.sqrt(max(0.0, 1.0 - float(np.sqrt(first * second).sum())))


# Cells of a patch each way. Up to this change of light, in grey levels, and up to this mean
# difference besides, a patch shows the same. Noise of single pixels averages out; a person who
# moves or leaves changes a patch by far more.
_PATCH_CELLS, _MAX_LIGHT, _MAX_DIFFERENCE = 16, 15.0, 6.0
# Difference of means over 3x3 cells from which a person has moved, grey levels. In 60 rendered
# films (once, without a command), it is less in 78 % of pairs of frames in which no joint moves,
# and in 1.8 % of those in which one moves by a twentieth of the body; most of these are hidden.
_MOVED_DIFFERENCE = 3.0


@dataclass(frozen=True)
class Patch:
    """A small grey picture ``(16, 16)`` of a box, which is in pixels of the frame."""

    box: Box
    grey: NDArray[np.float32]

    @classmethod
    def of(cls, frame: Frame, box: Box) -> Self:
        """The patch in a box of a frame ``(H, W, 3)``, BGR."""
        pixels, scale = seen_at(frame, HALF)
        # The same part of the frame, whether all of it is decoded or half.
        edges = (round(scale / HALF) * edge for edge in box.scaled(HALF).pixels())
        left, top, right, bottom = edges
        rect = left, top, right - left, bottom - top
        cells = shrink_quickly(crop(pixels, rect), _PATCH_CELLS, _PATCH_CELLS)
        return cls(box, cv2.cvtColor(cells, cv2.COLOR_BGR2GRAY).astype(np.float32))

    def is_shown_by(self, frame: Frame) -> bool:
        """Whether another frame shows the same in this box, perhaps in different light."""
        change = self._change(frame)
        light = np.clip(np.median(change), -_MAX_LIGHT, _MAX_LIGHT)
        return bool(np.abs(change - light).mean() < _MAX_DIFFERENCE)

    def is_unchanged_in(self, frame: Frame) -> bool:
        """Whether nothing in this box has changed in another frame, not even a hand."""
        means = cv2.blur(self._change(frame), (3, 3))
        return bool(np.abs(means).max() < _MOVED_DIFFERENCE)

    def _change(self, frame: Frame) -> NDArray[np.float32]:
        return Patch.of(frame, self.box).grey - self.grey
