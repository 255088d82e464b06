"""What is watched for in a tracked person: postures, falls, zones, and the floor.

Lying and raised arms follow from filtered postures, falls from a model
(:mod:`app.tracking.falls`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.configuration import EventName
from app.networks.probabilities import ENDS_BELOW, MAX_STEP_S, Hysteresis
from app.tracking.falls import FallWatch
from app.tracking.floor import Rest
from app.tracking.results import Event, EventState
from app.tracking.zones import Zone, ZoneWatch, is_rest
from app.vision.geometry import Box
from index.posture import POSTURES, PostureName


class Watches:
    """Watches one track: its postures, falls and zones, and whether the person is on the floor.

    Events have no identities, which the track adds. ``watched_from`` is that of
    :class:`app.tracking.falls.FallWatch`.
    """

    def __init__(self, watched_from: float = math.inf) -> None:
        self._last_at: float | None = None
        self._postures: dict[Literal["arms_raised", "lying"], Hysteresis] = {
            "arms_raised": Hysteresis(),
            "lying": Hysteresis(),
        }
        self._falls, self._zones = FallWatch(watched_from), ZoneWatch()
        self.rest = Rest()

    @property
    def zones(self) -> tuple[str, ...]:
        """Names of the zones in which the person was last seen."""
        return tuple(zone.name for zone in self._zones.zones)

    @property
    def has_fallen(self) -> bool:
        """Whether the person fell and no frame showed them getting up."""
        return self._falls.report.fallen

    def enter(self, timestamp: float, zones: Iterable[Zone], box: Box, score: float) -> Event:
        """The event that a person with this box and probability has entered the picture."""
        self._zones.locate(zones, box, None)
        return self._here("entered", "instant", timestamp, score)

    def cross(
        self, timestamp: float, zones: Sequence[Zone], box: Box, posture: PostureName | None
    ) -> list[Event]:
        """Add the person's place; the posture says which part of the body has to be in a zone."""
        return self._zones.update(timestamp, zones, box, posture)

    def update(
        self,
        timestamp: float,
        shares: NDArray[np.float64],
        reliability: float,
        observation: NDArray[np.float64],
    ) -> list[Event]:
        """Add a frame that shows the body and return what begins, ends or happens with it.

        ``shares`` ``(10,)`` are the probabilities of ``POSTURES`` at this frame, weighted by
        ``reliability``, 0 to 1, that the body is read correctly. In a zone for resting, lying is
        not an event.
        """
        elapsed = 0.0 if self._last_at is None else min(timestamp - self._last_at, MAX_STEP_S)
        step, rests = reliability * elapsed, is_rest(self._zones.zones)
        self._last_at = timestamp
        events = []
        for name, state in self._postures.items():
            share = 0.0 if rests and name == "lying" else float(shares[POSTURES.index(name)])
            if change := state.change(share, step):
                events.append(self._here(name, change, timestamp, state.level))
        if self._falls.update(timestamp, observation, rests=rests, floor_odds=self.rest.odds):
            events.append(self._here("fell", "instant", timestamp, self._falls.probability))
        return events

    def lost(self, timestamp: float) -> list[Event]:
        """The fall of a person who is no longer visible, if the person was lost while falling."""
        if is_rest(self._zones.zones) or not self._falls.lost(timestamp):
            return []
        fell = self._here("fell", "instant", timestamp, self._falls.probability)
        return [replace(fell, lost=True)]

    def leave(self, timestamp: float, seen_at: float, score: float) -> list[Event]:
        """The events of a person, last seen at ``seen_at``, who has left their zones and all."""
        crossings = self._zones.end(timestamp, seen_at)
        return [*crossings, self._here("left", "instant", timestamp, score)]

    def unconfirmed(self) -> list[Event]:
        """Events that had begun to show at the last frame but were not certain."""
        levels: dict[EventName, float] = {
            name: state.level for name, state in self._postures.items() if state.is_unconfirmed
        }
        fell = self._falls.probability
        if fell >= ENDS_BELOW and not self.has_fallen and not is_rest(self._zones.zones):
            levels["fell"] = fell
        at = self._last_at or 0.0
        return [self._here(name, "unconfirmed", at, level) for name, level in levels.items()]

    def _here(self, name: EventName, state: EventState, timestamp: float, level: float) -> Event:
        """An event with the person's zones; lying and falls also with the floor."""
        on_floor = self.rest.on_floor if name in ("lying", "fell") else None
        return Event(name, state, timestamp, level, zones=self.zones, on_floor=on_floor)
