"""What happens to a tracked person: they lie down, fall or raise both arms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.parameters import DEFAULTS, EventParameters
from app.tracking.results import Event, EventName, EventState
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, Posture


class _Hysteresis:
    """A low-pass filtered probability, and whether something holds by it, with hysteresis."""

    def __init__(self, parameters: EventParameters) -> None:
        self._parameters = parameters
        self.level = 0.0
        self.holds = False
        self.since = 0.0

    def update(self, timestamp: float, probability: float, seconds: float) -> EventState | None:
        """Take in a frame that stands for some seconds; return what changed."""
        kept = math.exp(-seconds / self._parameters.settling_s)
        self.level = kept * self.level + (1 - kept) * probability
        if not self.holds and self.level >= self._parameters.begins_from:
            self.holds, self.since = True, timestamp
            return "begin"
        if self.holds and self.level < self._parameters.ends_below:
            self.holds = False
            return "end"
        return None


@dataclass(frozen=True)
class Reliability:
    """How far a frame of a track counts, 0 to 1.

    Parameters
    ----------
    body : float
        Probability that the body is read correctly.
    person : float
        Probability that there is a person at all.
    """

    body: float
    person: float


class EventDetector:
    """Watches the postures of one track."""

    def __init__(self, parameters: EventParameters = DEFAULTS.events) -> None:
        self._parameters = parameters
        self._last_at: float | None = None
        self._lying, self._arms_raised = _Hysteresis(parameters), _Hysteresis(parameters)
        self._down, self._upright = _Hysteresis(parameters), _Hysteresis(parameters)
        self._upright_at: float | None = None
        self._upright_px: float | None = None
        self._fallen = False

    def update(
        self,
        track_id: int,
        timestamp: float,
        shares: NDArray[np.float64],
        reliability: Reliability,
        height_px: float | None = None,
        *,
        rests: bool = False,
    ) -> tuple[Event, ...]:
        """Take in a frame of the track and return what begins, ends or happens with it.

        Parameters
        ----------
        track_id : int
            Of the events.
        timestamp : float
            Seconds, after those of the frames before.
        shares : (10,) float64 array
            Probability of each of ``POSTURES`` at this frame.
        reliability : Reliability
            Weights of the frame: of its posture that the body is read correctly, of being down
            that there is a person.
        height_px : float, optional
            Of the person in the picture; None where part of them is not seen.
        rests : bool
            Whether the person is in a zone for resting, where lying is no event.
        """
        max_step_s = self._parameters.max_step_s
        elapsed = 0.0 if self._last_at is None else min(timestamp - self._last_at, max_step_s)
        step = reliability.body * elapsed
        self._last_at = timestamp

        def share(*postures: Posture) -> float:
            return float(sum(shares[POSTURES.index(posture)] for posture in postures))

        def happened(name: EventName, state: EventState | None, level: float) -> list[Event]:
            return [Event(name, track_id, state, timestamp, level)] if state else []

        self._remember_upright(timestamp, share(*UPRIGHT), step, height_px)
        state = self._arms_raised.update(timestamp, share("arms_raised"), step)
        events = happened("arms_raised", state, self._arms_raised.level)
        state = self._lying.update(timestamp, 0.0 if rests else share("lying"), step)
        events += happened("lying", state, self._lying.level)
        down = 1.0 if self._dropped(height_px) else share(*ON_THE_GROUND)
        self._down.update(timestamp, 0.0 if rests else down, reliability.person * elapsed)
        fell: EventState | None = "instant" if self._fell(timestamp) else None
        return (*events, *happened("fell", fell, self._down.level))

    def _remember_upright(
        self, timestamp: float, upright: float, step: float, height_px: float | None
    ) -> None:
        """Note when, and how tall in the picture, the person was last upright."""
        self._upright.update(timestamp, upright, step)
        surely = self._upright.holds and upright >= self._parameters.begins_from
        if not surely or self._dropped(height_px):
            return
        self._upright_at = timestamp
        if height_px is not None:
            known = self._upright_px or height_px
            gain = 1 - math.exp(-step / self._parameters.settling_s)
            self._upright_px = known + gain * (height_px - known)

    def _dropped(self, height_px: float | None) -> bool:
        """Whether the person is far lower than when they were upright."""
        if height_px is None or self._upright_px is None:
            return False
        return height_px < self._parameters.dropped_to * self._upright_px

    def _fell(self, timestamp: float) -> bool:
        """Whether a fall is certain as of now; true once until the person is up again."""
        down = self._down
        self._fallen = self._fallen and down.holds
        if self._fallen or not down.holds or self._upright_at is None:
            return False
        suddenly = 0 <= down.since - self._upright_at <= self._parameters.falls_within_s
        self._fallen = suddenly and timestamp - down.since >= self._parameters.stays_down_s
        return self._fallen
