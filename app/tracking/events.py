"""What happens to a tracked person: they lie, they fell, they raise both arms."""

from __future__ import annotations

import math

from app.posture import VotedPosture
from app.tracking.results import Event, EventName, EventState
from index.posture import UPRIGHT, Posture

SETTLING_S = 0.5
"""Time constant with which the evidence follows the frames."""

BEGINS_FROM, ENDS_BELOW = 0.5, 0.2
"""Evidence at which something begins, and at which it ends."""

MOST_STEP_S = 0.2
"""A frame stands for no more than this, however long none came: a single one decides nothing."""

DOWN_WITHIN_S = 4.0
"""From the last moment upright to the ground; who takes longer lay down."""

STAYS_DOWN_S = 1.5
"""Seconds on the ground after which somebody fell."""

DOWN: tuple[Posture, ...] = ("lying", "crawling")
"""Who fell need not lie flat."""


class _Evidence:
    """How much the last frames speak for something, from 0 to 1, and whether it holds."""

    def __init__(self) -> None:
        self.level = 0.0
        self.holds = False
        self.since = 0.0

    def update(self, timestamp: float, probability: float, seconds: float) -> EventState | None:
        """Take in a frame that stands for some seconds; return what changed."""
        kept = math.exp(-seconds / SETTLING_S)
        self.level = kept * self.level + (1 - kept) * probability
        if not self.holds and self.level >= BEGINS_FROM:
            self.holds, self.since = True, timestamp
            return "begin"
        if self.holds and self.level < ENDS_BELOW:
            self.holds = False
            return "end"
        return None


class EventDetector:
    """Watches the postures of one track."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._lying, self._arms_raised = _Evidence(), _Evidence()
        self._down, self._upright = _Evidence(), _Evidence()
        self._upright_at: float | None = None
        self._fallen = False

    def update(
        self,
        track_id: int,
        timestamp: float,
        posture: VotedPosture,
        confidence: float,
        *,
        rests: bool = False,
    ) -> tuple[Event, ...]:
        """Take in a frame of the track and return what begins, ends or happens with it.

        Parameters
        ----------
        track_id : int
        timestamp : float
            Seconds, after those of the frames before.
        posture : VotedPosture
            Of this frame.
        confidence : float
            Of this frame's pose. A frame counts by it: a silhouette that nobody fits, of a person
            half hidden or cut out wrongly, says nothing.
        rests : bool
            Whether the person is in a zone for resting, where lying is no event.
        """
        step = 0.0 if self._last is None else min(timestamp - self._last, MOST_STEP_S)
        step *= confidence
        self._last = timestamp
        probability = posture.probability

        def happened(event: EventName, state: EventState | None, level: float) -> list[Event]:
            return [Event(event, track_id, state, timestamp, level)] if state else []

        upright = probability if posture.label in UPRIGHT else 0.0
        self._upright.update(timestamp, upright, step)
        if self._upright.holds and upright:
            self._upright_at = timestamp
        raised = probability if posture.label == "arms_raised" else 0.0
        events = happened(
            "arms_raised",
            self._arms_raised.update(timestamp, raised, step),
            self._arms_raised.level,
        )
        lies = probability if posture.label == "lying" and not rests else 0.0
        state = self._lying.update(timestamp, lies, step)
        events += happened("lying", state, self._lying.level)
        down = probability if posture.label in DOWN and not rests else 0.0
        self._down.update(timestamp, down, step)
        fell: EventState | None = "instant" if self._fell(timestamp) else None
        return (*events, *happened("fell", fell, self._down.level))

    def _fell(self, timestamp: float) -> bool:
        """Whether it is now certain that the person fell; told once until they are up again."""
        down = self._down
        self._fallen = self._fallen and down.holds
        if self._fallen or not down.holds or self._upright_at is None:
            return False
        suddenly = 0 <= down.since - self._upright_at <= DOWN_WITHIN_S
        self._fallen = suddenly and timestamp - down.since >= STAYS_DOWN_S
        return self._fallen
