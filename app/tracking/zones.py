"""Zones of a camera's picture: which zones a person is in, enters and leaves."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from app.configuration import ZoneKind
from app.tracking.results import Event
from app.vision.geometry import Box
from index.posture import ON_THE_GROUND, PostureName


@dataclass(frozen=True, eq=False)
class Zone:
    """A part of a camera's picture."""

    # The caller chooses name and kind.
    name: str
    kind: ZoneKind
    # (P, 2): its corners in order, in pixels of the frame; it may reach beyond the frame.
    polygon: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.polygon.ndim != 2 or self.polygon.shape[1] != 2 or len(self.polygon) < 3:
            raise ValueError(f"expected a polygon of shape (P, 2), got {self.polygon.shape}")


def crosses_itself(polygon: NDArray[np.float64]) -> bool:
    """Whether two edges of a polygon ``(P, 2)`` that share no corner cross."""
    starts, ends = polygon, np.roll(polygon, -1, axis=0)

    def side(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """On which side of each edge (rows) points (columns) lie."""
        (x, y), apart = (ends - starts).T[..., None], points[None] - starts[:, None]
        return np.sign(x * apart[..., 1] - y * apart[..., 0])

    divides = side(starts) * side(ends) < 0
    return bool((divides & divides.T).any())


def is_outside(polygon: NDArray[np.float64], shape: tuple[int, ...]) -> bool:
    """Whether a polygon ``(P, 2)`` lies wholly beside, above or below a frame ``(H, W, ...)``."""
    last = np.array([shape[1], shape[0]]) - 0.5
    return bool((polygon.max(axis=0) < -0.5).any() or (polygon.min(axis=0) > last).any())


def contains(polygon: NDArray[np.float64], point: NDArray[np.float64]) -> bool:
    """Whether a point ``(2,)`` lies in a polygon ``(P, 2)``, by the even-odd rule.

    A point on an edge that two polygons share lies in exactly one of them.
    """
    (x1, y1), (x2, y2) = polygon.T, np.roll(polygon, -1, axis=0).T
    x, y = point
    crossed = (y1 > y) != (y2 > y)
    rise = np.where(crossed, y2 - y1, 1.0)
    return bool((crossed & (x < x1 + (y - y1) * (x2 - x1) / rise)).sum() % 2)


def distance(polygon: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Distance of a point ``(2,)`` to the border of a polygon ``(P, 2)``, pixels."""
    inside_px = cv2.pointPolygonTest(polygon.astype(np.float32), tuple(point.tolist()), True)
    return abs(inside_px)


def place(box: Box, posture: PostureName | None) -> NDArray[np.float64]:
    """Where a person is ``(2,)``: at their feet, or at the centre of a body on the ground."""
    if posture in ON_THE_GROUND:
        return np.array([box.x + box.width / 2, box.y + box.height / 2])
    return box.foot


def is_rest(zones: Iterable[Zone]) -> bool:
    return any(zone.kind == "rest" for zone in zones)


@dataclass
class _Stay:
    """The stay of a person who is in a zone or about to enter it; all times in seconds.

    The person has entered the zone after being inside for long enough. ``outside_since`` is when
    they were first seen outside again; None while inside.
    """

    since: float
    entered: bool = False
    outside_since: float | None = None


# After entering, a person stays in the zone up to this distance outside, in sizes of the person:
# feet at a border move by some hundredths of a body from frame to frame.
_MARGIN = 0.1
STAYS_FROM_S = 0.5
"""Time inside or outside before an event is reported."""


class ZoneWatch:
    """Watches which zones a person is in.

    A person enters a zone by staying inside its polygon for a while, and leaves it by staying
    outside by a margin for a while. Its events have no ``track_id``, which the track sets.
    """

    def __init__(self) -> None:
        self.zones: tuple[Zone, ...] = ()
        """Zones in which the person was last seen, however briefly."""
        self._stays: dict[str, _Stay] = {}
        self._posture: PostureName | None = None

    def locate(self, zones: Iterable[Zone], box: Box, posture: PostureName | None) -> None:
        """Set the zones that the person is in, in the order given.

        A zone that was entered is kept up to the margin, and an unclear posture is the last one, so
        that a sleeper at a border does not change places.
        """
        self._posture = posture or self._posture
        point, margin_px = place(box, self._posture), _MARGIN * max(box.width, box.height)

        def holds(zone: Zone) -> bool:
            stay = self._stays.get(zone.name)
            is_kept = stay is not None and stay.entered
            near = is_kept and distance(zone.polygon, point) <= margin_px
            return near or contains(zone.polygon, point)

        self.zones = tuple(filter(holds, zones))

    def update(
        self,
        timestamp: float,
        zones: Sequence[Zone],
        box: Box,
        posture: PostureName | None,
    ) -> list[Event]:
        """Add the person's place; return the zones entered and left, such as removed ones."""
        self.locate(zones, box, posture)
        events = []
        removed = self._stays.keys() - {zone.name for zone in zones}
        for name in sorted(removed):
            events += self._leave(name, timestamp, timestamp)
        for zone in zones:
            if zone in self.zones:
                events += self._inside(zone.name, timestamp)
            elif (stay := self._stays.get(zone.name)) is not None:
                events += self._outside(zone.name, stay, timestamp)
        return events

    def _inside(self, name: str, timestamp: float) -> list[Event]:
        stay = self._stays.setdefault(name, _Stay(timestamp))
        stay.outside_since = None
        if stay.entered or timestamp - stay.since < STAYS_FROM_S:
            return []
        stay.entered = True
        return [Event("zone_entered", "instant", timestamp, 1.0, zones=(name,))]

    def _outside(self, name: str, stay: _Stay, timestamp: float) -> list[Event]:
        if stay.outside_since is None:
            stay.outside_since = timestamp
        if stay.entered and timestamp - stay.outside_since < STAYS_FROM_S:
            return []
        return self._leave(name, timestamp, timestamp)

    def end(self, timestamp: float, seen_at: float) -> list[Event]:
        """Leave all zones; the person was last seen at ``seen_at``."""
        return [event for name in [*self._stays] for event in self._leave(name, timestamp, seen_at)]

    def _leave(self, name: str, timestamp: float, seen_at: float) -> list[Event]:
        stay = self._stays.pop(name)
        if not stay.entered:
            return []
        until = seen_at if stay.outside_since is None else stay.outside_since
        dwell_s = max(0.0, until - stay.since)
        return [Event("zone_left", "instant", timestamp, 1.0, zones=(name,), dwell_s=dwell_s)]
