"""What happens to a tracked person: they lie down, fall or raise both arms."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.parameters import DEFAULTS, EventParameters
from app.tracking.results import Event, EventName, EventState
from index.posture import ON_THE_GROUND, POSTURES, UPRIGHT, Posture

_ON_THEIR_FEET: tuple[Posture, ...] = (*UPRIGHT, "bending")


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


@dataclass(frozen=True)
class HipHeight:
    """How high the hips are in the picture.

    Parameters
    ----------
    y_px : float
        Pixels, downwards.
    px_per_m : float
        Pixels per vertical metre of the person.
    """

    y_px: float
    px_per_m: float

    @classmethod
    def seen(
        cls,
        y_px: float,
        px_per_m: float,
        elevation_deg: float,
        parameters: EventParameters = DEFAULTS.events,
    ) -> HipHeight:
        """The height as a camera sees it at an elevation, which foreshortens vertical metres."""
        angle = math.radians(min(abs(elevation_deg), parameters.max_elevation_deg))
        return cls(y_px, px_per_m * math.cos(angle))


class DropDetector:
    """Watches how far and how fast a person's hips sink."""

    def __init__(self, parameters: EventParameters = DEFAULTS.events) -> None:
        self._parameters = parameters
        self._recent: deque[tuple[float, HipHeight]] = deque()
        self._top_px = 0.0
        self._bottom_px = 0.0
        self._drops = False
        self._drop_m = 0.0
        self.dropped_at: float | None = None
        """When the hips began to be far below where they were, seconds; None if they are not."""

    def update(self, timestamp: float, hips: HipHeight) -> None:
        """Take in where the hips are."""
        limits = self._parameters
        self._recent.append((timestamp, hips))
        while self._recent[0][0] < timestamp - limits.drop_within_s:
            self._recent.popleft()
        px_per_m = float(np.median([one.px_per_m for _, one in self._recent]))
        top_px = min(one.y_px for _, one in self._recent)
        drops = hips.y_px - top_px >= limits.min_drop_m * px_per_m
        if drops:
            if not self._drops:
                self.dropped_at, self._top_px = timestamp, top_px
            self._bottom_px = max(hips.y_px, self._top_px + limits.min_drop_m * px_per_m)
            self._drop_m = (hips.y_px - self._top_px) / px_per_m
        elif self.dropped_at is not None:
            kept_px = limits.kept_drop * (self._bottom_px - self._top_px)
            if hips.y_px - self._top_px < kept_px:
                self.dropped_at = None
        self._drops = drops

    def min_on_ground(self) -> float:
        """Probability of being on the ground that makes the last drop a fall."""
        limits = self._parameters
        deeper_m = max(0.0, self._drop_m - limits.min_drop_m)
        needed = limits.min_on_ground - limits.on_ground_per_m * deeper_m
        return max(limits.min_on_ground_after_deep_drop, needed)


class ShrinkDetector:
    """Watches whether a person is far lower in the picture than when they were upright.

    A body that is read wrongly has no hips to follow, but its box shrinks with it.
    """

    def __init__(self, parameters: EventParameters = DEFAULTS.events) -> None:
        self._parameters = parameters
        self._upright, self._low = _Hysteresis(parameters), _Hysteresis(parameters)
        self._upright_at: float | None = None
        self._upright_px: float | None = None

    @property
    def is_low(self) -> bool:
        """Whether the person is lower as of now."""
        return self._low.holds

    def update(
        self, timestamp: float, upright: float, height_px: float | None, seconds: float
    ) -> bool:
        """Take in a frame; return whether the person sank suddenly and stayed down.

        Parameters
        ----------
        timestamp : float
            Seconds.
        upright : float
            Probability that the person is on their feet, if bent.
        height_px : float or None
            Of the person in the picture; None where part of them is not seen.
        seconds : float
            That the frame stands for.
        """
        limits = self._parameters
        low = height_px is not None and (height_px < limits.shrunk_to * (self._upright_px or 0.0))
        self._upright.update(timestamp, upright, seconds)
        if self._upright.holds and upright >= limits.begins_from and not low:
            self._upright_at = timestamp
            if height_px is not None:
                known = self._upright_px or height_px
                gain = 1 - math.exp(-seconds / limits.settling_s)
                self._upright_px = known + gain * (height_px - known)
        self._low.update(timestamp, float(low), seconds)
        if not self._low.holds or self._upright_at is None:
            return False
        suddenly = 0 <= self._low.since - self._upright_at <= limits.shrinks_within_s
        return suddenly and timestamp - self._low.since >= limits.stays_low_s


class EventDetector:
    """Watches the postures of one track, the height of its hips, and its own height."""

    def __init__(self, parameters: EventParameters = DEFAULTS.events) -> None:
        self._parameters = parameters
        self._last_at: float | None = None
        self._lying, self._arms_raised = _Hysteresis(parameters), _Hysteresis(parameters)
        self._down = _Hysteresis(parameters)
        self._drop, self._shrink = DropDetector(parameters), ShrinkDetector(parameters)
        self._fallen = False
        self._down_s = 0.0
        """Seconds on the ground after a drop."""

    def update(
        self,
        track_id: int,
        timestamp: float,
        shares: NDArray[np.float64],
        reliability: Reliability,
        hips: HipHeight | None = None,
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
        hips : HipHeight, optional
            None where they are not seen.
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

        state = self._arms_raised.update(timestamp, share("arms_raised"), step)
        events = happened("arms_raised", state, self._arms_raised.level)
        state = self._lying.update(timestamp, 0.0 if rests else share("lying"), step)
        events += happened("lying", state, self._lying.level)
        if hips is not None:
            self._drop.update(timestamp, hips)
        on_the_ground = 0.0 if rests else share(*ON_THE_GROUND)
        self._down.update(timestamp, on_the_ground, reliability.person * elapsed)
        seconds = reliability.person * elapsed
        on_their_feet = share(*_ON_THEIR_FEET)
        sank = self._shrink.update(timestamp, on_their_feet, height_px, seconds) and not rests
        fell: EventState | None = "instant" if self._fell(timestamp, elapsed, sank) else None
        return (*events, *happened("fell", fell, self._down.level))

    def _fell(self, timestamp: float, elapsed: float, sank: bool) -> bool:
        """Whether a fall is certain as of now; true once until the person is up again."""
        if self._down.level < self._parameters.ends_below and not self._shrink.is_low:
            self._fallen = False
        certain = self._is_down_after_drop(timestamp, elapsed) or sank
        if self._fallen or not certain:
            return False
        self._fallen = True
        return True

    def _is_down_after_drop(self, timestamp: float, elapsed: float) -> bool:
        drop, limits, level = self._drop, self._parameters, self._down.level
        if drop.dropped_at is None or level < drop.min_on_ground():
            self._down_s = 0.0
            return False
        if self._down_s == 0.0 and timestamp - drop.dropped_at > limits.down_within_s:
            return False
        self._down_s += elapsed
        return self._down_s >= limits.stays_down_s
