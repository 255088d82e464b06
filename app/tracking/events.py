"""What happens to a tracked person: they lie, they fell, they raise both arms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.results import Event, EventName, EventState
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, Posture

SETTLING_S = 0.5
"""Time constant of the low-pass filter over the frames' probabilities."""

BEGINS_FROM, ENDS_BELOW = 0.5, 0.2
"""Filtered probability at which something begins, and at which it ends."""

MOST_STEP_S = 0.34
"""A frame stands for no more than this, however long none came: a single one takes the filter
just short of where something begins."""

DOWN_WITHIN_S = 4.0
"""From the last moment upright to the ground; who takes longer lay down."""

STAYS_DOWN_S = 1.5
"""Seconds on the ground after which somebody fell."""

DROPPED_TO = 0.55
"""Share of the height in the picture that somebody has upright, below which they are down, whatever
the posture: who sits on a chair or kneels keeps two thirds."""


class _Hysteresis:
    """A probability, low-pass filtered over the frames, and whether it holds, with hysteresis."""

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


@dataclass(frozen=True)
class Trust:
    """How far a frame of a track is to be trusted, 0 to 1.

    Parameters
    ----------
    body : float
        That the body is read rightly.
    person : float
        That there is a person at all.
    """

    body: float
    person: float


class EventDetector:
    """Watches the postures of one track."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._lying, self._arms_raised = _Hysteresis(), _Hysteresis()
        self._down, self._upright = _Hysteresis(), _Hysteresis()
        self._upright_at: float | None = None
        self._upright_px: float | None = None
        self._fallen = False

    def update(
        self,
        track_id: int,
        timestamp: float,
        shares: NDArray[np.float64],
        trust: Trust,
        height_px: float | None = None,
        *,
        rests: bool = False,
    ) -> tuple[Event, ...]:
        """Take in a frame of the track and return what begins, ends or happens with it.

        Parameters
        ----------
        track_id : int
        timestamp : float
            Seconds, after those of the frames before.
        shares : (10,) float64 array
            How likely each of ``POSTURES`` is at this frame.
        trust : Trust
            Of this frame, which counts by it: a silhouette that nobody fits says nothing. Who was
            upright and is down counts as long as it is a person.
        height_px : float, optional
            Of the person in the picture; None where not all of them is seen.
        rests : bool
            Whether the person is in a zone for resting, where lying is no event.
        """
        elapsed = 0.0 if self._last is None else min(timestamp - self._last, MOST_STEP_S)
        step = trust.body * elapsed
        self._last = timestamp

        def share(*postures: Posture) -> float:
            return float(sum(shares[POSTURES.index(posture)] for posture in postures))

        def happened(event: EventName, state: EventState | None, level: float) -> list[Event]:
            return [Event(event, track_id, state, timestamp, level)] if state else []

        upright = share(*UPRIGHT)
        self._upright.update(timestamp, upright, step)
        if self._upright.holds and upright >= BEGINS_FROM and not self._dropped(height_px):
            self._upright_at = timestamp
            if height_px is not None:
                known = self._upright_px or height_px
                self._upright_px = known + (1 - math.exp(-step / SETTLING_S)) * (height_px - known)
        raised = share("arms_raised")
        events = happened(
            "arms_raised",
            self._arms_raised.update(timestamp, raised, step),
            self._arms_raised.level,
        )
        lies = 0.0 if rests else share("lying")
        state = self._lying.update(timestamp, lies, step)
        events += happened("lying", state, self._lying.level)
        down = 1.0 if self._dropped(height_px) else share(*ON_THE_GROUND)
        self._down.update(timestamp, 0.0 if rests else down, trust.person * elapsed)
        fell: EventState | None = "instant" if self._fell(timestamp) else None
        return (*events, *happened("fell", fell, self._down.level))

    def _dropped(self, height_px: float | None) -> bool:
        """Whether somebody is far lower than when they were upright."""
        if height_px is None or self._upright_px is None:
            return False
        return height_px < DROPPED_TO * self._upright_px

    def _fell(self, timestamp: float) -> bool:
        """Whether it is now certain that the person fell; told once until they are up again."""
        down = self._down
        self._fallen = self._fallen and down.holds
        if self._fallen or not down.holds or self._upright_at is None:
            return False
        suddenly = 0 <= down.since - self._upright_at <= DOWN_WITHIN_S
        self._fallen = suddenly and timestamp - down.since >= STAYS_DOWN_S
        return self._fallen
