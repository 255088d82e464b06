"""Where in a frame people are: the segmentation network's answer at several scales."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.networks import PersonNetwork
from app.vision.resampling import Window, resize

# The network finds people from about a quarter of its window's side up to all of it.
_LEAST_SHARE = 0.25
# Next finer windows are at least a fourth as large: people of all sizes between fit one of two.
_FINER = 4.0
_OVERLAP = 0.2
SUITED = (0.2, 1.0)
"""Shares of a window's side: of people of other sizes a map tells little."""

WIDE = 1.2
"""What hangs together and is so many times as wide as high may be somebody who lies, else somebody
who stands."""

LEVELS = (0.3, 0.6, 0.9)
"""Of probability, from which what hangs together may be somebody."""

# Within this share of a window's side from its edge its answer counts less than the next's.
_EDGE = 1 / 6


@dataclass(frozen=True)
class Piece:
    """A connected part of a presence map.

    Parameters
    ----------
    window : (left, top, width, height)
        About it, in whole pixels.
    area : int
        Pixels.
    labels : (H, W) int32 array
        Of the map that it is part of.
    label : int
        Its own.
    """

    window: Window
    area: int
    labels: NDArray[np.int32]
    label: int

    @property
    def place(self) -> tuple[slice, slice]:
        """Rows and columns of its window."""
        left, top, width, height = self.window
        return slice(top, top + height), slice(left, left + width)

    def mask(self) -> NDArray[np.bool_]:
        """Its pixels in its window."""
        return np.asarray(self.labels[self.place] == self.label)


@dataclass(frozen=True)
class PresenceMap:
    """Probability of a person at each pixel, as seen through windows of one size.

    Parameters
    ----------
    probability : (H, W) float32 array
        0 to 1, of the frame's size.
    side : float
        Side of the windows in pixels: people of 0.25 to 0.9 of it are seen well.
    """

    probability: NDArray[np.float32]
    side: float

    @cached_property
    def pieces(self) -> list[Piece]:
        """What hangs together, where somebody is likelier than each of :data:`LEVELS`."""
        found = []
        for level in LEVELS:
            region = (self.probability > level).astype(np.uint8)
            _, numbers, stats, _ = cv2.connectedComponentsWithStats(region)
            labels = np.asarray(numbers, np.int32)
            # The first is what lies about all others.
            for label, (left, top, width, height, area) in enumerate(stats[1:].tolist(), start=1):
                found.append(Piece((left, top, width, height), area, labels, label))
        return found


@dataclass(frozen=True)
class Presence:
    """Where the network saw somebody in a frame.

    Parameters
    ----------
    maps : list of PresenceMap
        From coarse to fine.
    factor : float
        By which the frame was resized before the network looked.
    min_person_px : float
        Height of the smallest person that was looked for, in pixels of the maps.
    """

    maps: list[PresenceMap]
    factor: float
    min_person_px: float


def presence_maps(
    network: PersonNetwork, frame: NDArray[np.uint8], min_person_px: float
) -> list[PresenceMap]:
    """Look for people through windows of the whole frame and of ever smaller parts.

    Parameters
    ----------
    network : PersonNetwork
    frame : (H, W, 3) uint8 array
        BGR.
    min_person_px : float
        Height of the smallest person wanted, in pixels.

    Returns
    -------
    list of PresenceMap
        From coarse to fine.
    """
    height, width = frame.shape[:2]
    sides = _window_sides(width, height, min_person_px)
    layers = [_tiles(width, height, side) for side in sides]
    answers = iter(network.probabilities(frame, [w for layer in layers for w in layer]))
    maps = []
    for side, layer in zip(sides, layers, strict=True):
        total: NDArray[np.float32] = np.zeros((height, width), np.float32)
        weight: NDArray[np.float32] = np.full((height, width), 1e-6, np.float32)
        for window, answer in zip(layer, answers, strict=False):
            left, top, columns, rows = window
            area = np.s_[top : top + rows, left : left + columns]
            hat = np.minimum(_hat(rows)[:, None], _hat(columns)[None, :])
            total[area] += resize(answer, columns, rows) * hat
            weight[area] += hat
        maps.append(PresenceMap(total / weight, side))
    return maps


def _window_sides(width: int, height: int, min_person_px: float) -> list[int]:
    """Sides of square windows, from the whole frame to the finest that is needed."""
    long, short = max(width, height), min(width, height)
    coarsest = long if long <= 1.5 * short else short
    finest = max(32.0, min_person_px / _LEAST_SHARE)
    if coarsest <= 1.25 * finest:
        return [coarsest]
    steps = int(np.ceil(np.log(coarsest / finest) / np.log(_FINER)))
    return [round(side) for side in np.geomspace(coarsest, finest, steps + 1).tolist()]


def _tiles(width: int, height: int, side: int) -> list[Window]:
    """Cover a frame with overlapping windows; a window never exceeds the frame."""
    columns, rows = min(side, width), min(side, height)

    def starts(length: int, window: int) -> NDArray[np.int64]:
        count = int(np.ceil((length - window) / (window * (1 - _OVERLAP)))) + 1
        return np.linspace(0, length - window, count).astype(np.int64)

    return [
        (int(x), int(y), columns, rows)
        for y in starts(height, rows)
        for x in starts(width, columns)
    ]


def _hat(length: int) -> NDArray[np.float32]:
    """Weights along a window's side: 1 in its middle, falling to almost 0 at its ends."""
    steps = np.minimum(np.arange(length) + 1, np.arange(length, 0, -1))
    return np.clip(steps / (length * _EDGE), 0.02, 1).astype(np.float32)
