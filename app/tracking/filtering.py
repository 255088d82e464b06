"""Probabilities of single frames, low-pass filtered: no single frame begins an event."""

import math

from app.tracking.results import EventState

SETTLING_S, MAX_STEP_S = 0.5, 0.34
"""Time constant for events of a person, and the most time that a single frame counts for: just too
short to begin an event."""

# Filtered probability at which an event begins.
_BEGINS_FROM = 0.5

ENDS_BELOW = 0.2
"""Filtered probability below which an event ends."""


class LowPass:
    """A probability, low-pass filtered over ``settling_s``."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._settling_s = settling_s
        self.level = 0.0

    def update(self, probability: float, seconds: float) -> float:
        """Add a frame that counts for ``seconds``; return the filtered probability."""
        kept = math.exp(-seconds / self._settling_s)
        self.level = kept * self.level + (1 - kept) * probability
        return self.level


class Hysteresis:
    """A state that follows a low-pass filtered probability."""

    def __init__(self, settling_s: float = SETTLING_S) -> None:
        self._filter = LowPass(settling_s)
        self.holds = False

    @property
    def level(self) -> float:
        """The filtered probability."""
        return self._filter.level

    def update(self, probability: float, seconds: float) -> EventState | None:
        """Add a frame that counts for ``seconds``; return the change of state, if any."""
        level = self._filter.update(probability, seconds)
        if not self.holds and level >= _BEGINS_FROM:
            self.holds = True
            return "begin"
        if self.holds and level < ENDS_BELOW:
            self.holds = False
            return "end"
        return None

    @property
    def is_unconfirmed(self) -> bool:
        """Whether the event has begun to show but is not certain."""
        return not self.holds and self.level >= ENDS_BELOW
