"""Zones of a camera's picture, and which of them a person is in."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.vision.geometry import Box
from index.posture import ON_THE_GROUND, Posture

MIN_SPREAD_PX = 0.5

ZoneKind = Literal["rest", "watch"]
"""``rest``: a bed or a sofa, where lying is no event; ``watch``: any other place of interest."""


@dataclass(frozen=True, eq=False)
class Zone:
    """A part of a camera's picture.

    Parameters
    ----------
    name, kind : str
        As the caller chose them.
    polygon : (P, 2) float64 array
        Its corners in order, in pixels of the frame; it may reach beyond the frame.
    """

    name: str
    kind: ZoneKind
    polygon: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.polygon.ndim != 2 or self.polygon.shape[1] != 2 or len(self.polygon) < 3:
            raise ValueError(f"expected a polygon of shape (P, 2), got {self.polygon.shape}")


def has_area(polygon: NDArray[np.float64]) -> bool:
    """Whether the corners ``(P, 2)`` are more than half a pixel away from a common line."""
    spread = np.linalg.svd(polygon - polygon.mean(axis=0), compute_uv=False)[-1]
    return bool(spread / math.sqrt(len(polygon)) > MIN_SPREAD_PX)


def contains(polygon: NDArray[np.float64], point: NDArray[np.float64]) -> bool:
    """Whether a point ``(2,)`` lies in a polygon ``(P, 2)``, by the even-odd rule.

    A point on an edge that two polygons share lies in exactly one of them.
    """
    (x1, y1), (x2, y2) = polygon.T, np.roll(polygon, -1, axis=0).T
    x, y = point
    crossed = (y1 > y) != (y2 > y)
    rise = np.where(crossed, y2 - y1, 1.0)
    return bool((crossed & (x < x1 + (y - y1) * (x2 - x1) / rise)).sum() % 2)


def place(box: Box, posture: Posture | None) -> NDArray[np.float64]:
    """Where a person is ``(2,)``: at their feet, or at the centre of a body on the ground."""
    if posture in ON_THE_GROUND:
        return np.array([box.x + box.width / 2, box.y + box.height / 2])
    return box.foot


def zones_of(zones: Iterable[Zone], box: Box, posture: Posture | None) -> tuple[Zone, ...]:
    """The zones in which a person is, in the order given."""
    point = place(box, posture)
    return tuple(zone for zone in zones if contains(zone.polygon, point))


def is_rest(zones: Iterable[Zone]) -> bool:
    """Whether any of the zones is for resting."""
    return any(zone.kind == "rest" for zone in zones)
