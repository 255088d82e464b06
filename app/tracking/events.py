"""Events of a tracked person: the person lies down, falls or raises both arms.

Lying and raised arms follow from filtered postures, falls from a model
(:mod:`app.tracking.falls`).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.configuration import EventName
from app.networks.probabilities import ENDS_BELOW, MAX_STEP_S, Hysteresis
from app.tracking.falls import FallWatch, Observation
from app.tracking.results import Event
from index.posture import POSTURES


class EventDetector:
    """Watches the postures of one track, and whether the person falls.

    Its events have no ``track_id``, which the track sets. ``watched_from`` is that of
    :class:`app.tracking.falls.FallWatch`.
    """

    def __init__(self, watched_from: float = math.inf) -> None:
        self._last_at: float | None = None
        self._states: dict[Literal["arms_raised", "lying"], Hysteresis] = {
            "arms_raised": Hysteresis(),
            "lying": Hysteresis(),
        }
        self._falls = FallWatch(watched_from)
        self._rests = False

    def update(
        self,
        timestamp: float,
        shares: NDArray[np.float64],
        reliability: float,
        observation: Observation,
        *,
        rests: bool = False,
    ) -> tuple[Event, ...]:
        """Add a frame of the track and return what begins, ends or happens with it.

        ``shares`` ``(10,)`` are the probabilities of ``POSTURES`` at this frame, weighted by
        ``reliability``, 0 to 1, that the body is read correctly. ``rests`` is whether the person is
        in a zone for resting, where lying is not an event.
        """
        elapsed = 0.0 if self._last_at is None else min(timestamp - self._last_at, MAX_STEP_S)
        step = reliability * elapsed
        self._last_at, self._rests = timestamp, rests
        events = []
        for name, state in self._states.items():
            share = 0.0 if rests and name == "lying" else float(shares[POSTURES.index(name)])
            if change := state.change(share, step):
                events.append(Event(name, change, timestamp, state.level))
        if self._falls.update(timestamp, observation.row(), rests=rests):
            events.append(Event("fell", "instant", timestamp, self._falls.probability))
        return tuple(events)

    def lost(self, timestamp: float) -> tuple[Event, ...]:
        """The fall of a person who is no longer visible, if the person was lost while falling."""
        if self._rests or not self._falls.lost(timestamp):
            return ()
        return (Event("fell", "instant", timestamp, self._falls.probability, lost=True),)

    @property
    def has_fallen(self) -> bool:
        return self._falls.report.fallen

    def unconfirmed(self) -> tuple[Event, ...]:
        levels: dict[EventName, float] = {
            name: state.level for name, state in self._states.items() if state.is_unconfirmed
        }
        fell = self._falls.probability
        if fell >= ENDS_BELOW and not self.has_fallen and not self._rests:
            levels["fell"] = fell
        at = self._last_at or 0.0
        return tuple(Event(name, "unconfirmed", at, level) for name, level in levels.items())
