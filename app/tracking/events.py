"""Events of a tracked person: the person lies down, falls or raises both arms.

Lying and raised arms follow from filtered postures, falls from a model
(:mod:`app.tracking.falls`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.tracking.falls import FallWatch, Observation
from app.tracking.filtering import ENDS_BELOW, MAX_STEP_S, Hysteresis
from app.tracking.results import Event, EventName, EventState
from index.posture import POSTURES


class EventDetector:
    """Watches the postures of one track, and whether the person falls.

    Its events have no ``track_id``, which the track sets.
    """

    def __init__(self) -> None:
        self._last_at: float | None = None
        self._lying, self._arms_raised = Hysteresis(), Hysteresis()
        self._falls = FallWatch()
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

        ``shares`` ``(10,)`` are the probabilities of ``POSTURES`` at this frame. They are weighted
        by ``reliability``, 0 to 1, the probability that the body is read correctly. ``rests`` says
        whether the person is in a zone for resting, where lying is not an event.
        """
        elapsed = 0.0 if self._last_at is None else min(timestamp - self._last_at, MAX_STEP_S)
        step = reliability * elapsed
        self._last_at, self._rests = timestamp, rests

        def happened(name: EventName, state: EventState | None, level: float) -> list[Event]:
            return [Event(name, state, timestamp, level)] if state else []

        raised = float(shares[POSTURES.index("arms_raised")])
        state = self._arms_raised.update(raised, step)
        events = happened("arms_raised", state, self._arms_raised.level)
        lies = 0.0 if rests else float(shares[POSTURES.index("lying")])
        state = self._lying.update(lies, step)
        events += happened("lying", state, self._lying.level)
        fell = self._falls.update(timestamp, observation.row(), rests=rests)
        return (*events, *happened("fell", "instant" if fell else None, self._falls.probability))

    def lost(self, timestamp: float) -> tuple[Event, ...]:
        """The fall of a person who is no longer visible, if the person was lost while falling."""
        if self._rests or not self._falls.lost(timestamp):
            return ()
        return (Event("fell", "instant", timestamp, self._falls.probability, lost=True),)

    @property
    def has_fallen(self) -> bool:
        """Whether the person fell and no frame showed them getting up."""
        return self._falls.fallen

    def unconfirmed(self) -> tuple[Event, ...]:
        """Events that had begun to show at the last frame but were not certain."""
        shown: dict[EventName, float] = {
            "arms_raised": 0.0 if self._arms_raised.holds else self._arms_raised.level,
            "lying": 0.0 if self._lying.holds else self._lying.level,
            "fell": 0.0 if self._falls.fallen or self._rests else self._falls.probability,
        }
        return tuple(
            Event(name, "unconfirmed", self._last_at or 0.0, level)
            for name, level in shown.items()
            if level >= ENDS_BELOW
        )
