"""What happens to a tracked person: they lie down, fall or raise both arms.

A fall is seen by the hips, which sink fast, and by the posture after it. Where the posture stays
unclear, as of small people and of heads towards the camera, or where the person is lost, it is seen
by the box, whose top sinks.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.tracking.results import Event, EventName, EventState
from app.vision.geometry import Box
from app.vision.truncation import gaps_to_border
from index.posture import ON_THE_GROUND, POSTURES, PostureName

# Time constant of the low-pass filter over the frames.
_SETTLING_S = 0.5
# Filtered probability at which something begins, and below which it ends.
_BEGINS_FROM, _ENDS_BELOW = 0.5, 0.2


class _Hysteresis:
    """A low-pass filtered probability, and a state that follows it with hysteresis."""

    def __init__(self) -> None:
        self.level = 0.0
        self.holds = False
        self.since = 0.0

    def update(self, timestamp: float, probability: float, seconds: float) -> EventState | None:
        """Add a frame that counts for ``seconds``; return the change of state, if any."""
        kept = math.exp(-seconds / _SETTLING_S)
        self.level = kept * self.level + (1 - kept) * probability
        if not self.holds and self.level >= _BEGINS_FROM:
            self.holds, self.since = True, timestamp
            return "begin"
        if self.holds and self.level < _ENDS_BELOW:
            self.holds = False
            return "end"
        return None


@dataclass(frozen=True)
class Reliability:
    """Weight of a frame of a track, 0 to 1.

    ``body`` is the probability that the body is read correctly, ``person`` that there is a person.
    """

    body: float
    person: float


# Elevation of a camera up to which a drop is corrected for looking shorter from above.
_MAX_ELEVATION_DEG = 60.0


@dataclass(frozen=True)
class HipHeight:
    """How high the hips are in the picture: pixels downwards, and per vertical metre."""

    y_px: float
    px_per_m: float

    @classmethod
    def seen(cls, y_px: float, px_per_m: float, elevation_deg: float) -> HipHeight:
        """The height seen by a camera at an elevation, which foreshortens vertical metres."""
        angle = math.radians(min(abs(elevation_deg), _MAX_ELEVATION_DEG))
        return cls(y_px, px_per_m * math.cos(angle))


# A fall from standing, from a chair or out of bed takes the hips down by this many metres within so
# many seconds. Bending hardly moves them; people who go to bed lower them by 0.2 m.
_MIN_DROP_M, _DROP_WITHIN_S = 0.4, 1.5
# Share of the drop by which the hips stay down: after a jump, they come up again.
_KEPT_DROP = 0.6
# Filtered probability of being on the ground that a fall needs after such a drop, its reduction for
# every further metre, and its minimum: hips lower than a seat can only be on the ground.
_MIN_ON_GROUND, _ON_GROUND_PER_M, _MIN_ON_GROUND_AFTER_DEEP_DROP = 0.5, 1.0, 0.3


class DropDetector:
    """Watches how far and how fast a person's hips sink."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, HipHeight]] = deque()
        self._top_px = 0.0
        self._bottom_px = 0.0
        self._drops = False
        self._drop_m = 0.0
        self.dropped_at: float | None = None
        """Time at which the hips had sunk far enough, seconds; None unless they are still low."""

    def update(self, timestamp: float, hips: HipHeight) -> None:
        """Add the position of the hips in a frame."""
        self._recent.append((timestamp, hips))
        while self._recent[0][0] < timestamp - _DROP_WITHIN_S:
            self._recent.popleft()
        px_per_m = float(np.median([one.px_per_m for _, one in self._recent]))
        top_px = min(one.y_px for _, one in self._recent)
        drops = hips.y_px - top_px >= _MIN_DROP_M * px_per_m
        if drops:
            if not self._drops:
                self.dropped_at, self._top_px = timestamp, top_px
            self._bottom_px = max(hips.y_px, self._top_px + _MIN_DROP_M * px_per_m)
            self._drop_m = (hips.y_px - self._top_px) / px_per_m
        elif self.dropped_at is not None:
            kept_px = _KEPT_DROP * (self._bottom_px - self._top_px)
            if hips.y_px - self._top_px < kept_px:
                self.dropped_at = None
        self._drops = drops

    def min_on_ground(self) -> float:
        """Probability of being on the ground from which the last drop is a fall."""
        deeper_m = max(0.0, self._drop_m - _MIN_DROP_M)
        needed = _MIN_ON_GROUND - _ON_GROUND_PER_M * deeper_m
        return max(_MIN_ON_GROUND_AFTER_DEEP_DROP, needed)


# A person sinks if the top of the box sinks by this share of its height within so many seconds, its
# lower edge rises by no more than another (behind a table, only the lower edge moves), and its
# height shrinks to a third one (people who walk towards a high camera sink as a whole).
_SINKS_BY, _SINKS_WITHIN_S, _MAX_RISE, _SHRINKS_TO = 0.4, 1.6, 0.15, 0.75
# The same share for people who seem to sit: no seat is that low.
_SINKS_BELOW_SEATS_BY = 0.65
# The same share for people who are lost at once: they may have sunk further.
_SINKS_BEFORE_LOSS_BY, _LOST_WITHIN_S = 0.3, 2.0
# They are up again once the top has risen, and walk on once the foot has moved, by these shares of
# the height; a body that falls takes its middle along by half of it.
_UP_AGAIN_BY, _WALKS_ON_BY = 0.25, 1.0
# Share of the frame's sides from whose ends on people may be leaving it; the growth of the width
# from which a body tips over, as people who walk out below the camera hardly get wider; and the
# width, in heights, from which it lies across, as heads and shoulders are not that wide.
_BORDER_SHARE, _TIPS_BY, _LIES_ACROSS = 0.02, 1.6, 2.5


class SinkDetector:
    """Watches how far and how fast the top of a person's box sinks."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, Box]] = deque()
        self._before: Box | None = None
        self._top, self._foot = 0.0, np.zeros(2)
        self.sunk_at: float | None = None
        """Time at which the box had sunk far enough, seconds; None unless it is still low."""
        self.is_below_seats = False
        """Whether it has sunk farther than in sitting down."""

    def update(self, timestamp: float, box: Box) -> None:
        """Add the box of a frame."""
        self._recent.append((timestamp, box))
        while self._recent[0][0] < timestamp - _SINKS_WITHIN_S:
            self._recent.popleft()
        before = self._sinks_from(_SINKS_BY)
        if before is not None:
            if self.sunk_at is None:
                self.sunk_at, self._before, self._foot = timestamp, before, box.foot
            self._top = box.y
            self.is_below_seats |= self._sinks_from(_SINKS_BELOW_SEATS_BY) is not None
        if self._before is not None and self._is_up_again(box, self._before.height):
            self.sunk_at, self._before, self.is_below_seats = None, None, False

    def _is_up_again(self, box: Box, height: float) -> bool:
        """Whether a person who sank stands or walks again."""
        moved = float(np.linalg.norm(box.foot - self._foot))
        return box.y < self._top - _UP_AGAIN_BY * height or moved > _WALKS_ON_BY * height

    def was_lost(self, frame_shape: tuple[int, ...]) -> bool:
        """Whether a person who is not seen any more sank in the middle of the frame.

        People walk out of the frame at its left and right, and at its lower border, where their
        feet leave it first; there, only those who tip over or lie across have sunk.
        """
        if not self._recent:
            return False
        last_at, last = self._recent[-1]
        before = self._sinks_from(_SINKS_BEFORE_LOSS_BY)
        if self.sunk_at is not None and last_at - self.sunk_at <= _LOST_WITHIN_S:
            before = self._before
        if before is None:
            return False
        near = _BORDER_SHARE * np.array(frame_shape[:2])
        left, _, right, lower = gaps_to_border(last, frame_shape)
        leaves = lower <= near[0]
        leaves &= max(box.width for _, box in self._recent) < _TIPS_BY * before.width
        leaves &= last.width < _LIES_ACROSS * last.height
        return not leaves and min(left, right) > near[1]

    def _sinks_from(self, share: float) -> Box | None:
        """The highest recent box from which the last one has sunk by a share of its height."""
        _, last = self._recent[-1]
        higher = [
            box
            for _, box in self._recent
            if last.y - box.y >= share * box.height
            and last.bottom >= box.bottom - _MAX_RISE * box.height
            and last.height <= _SHRINKS_TO * box.height
        ]
        return min(higher, key=lambda box: box.y, default=None)


# Most time that a single frame counts for: just too short to begin an event.
_MAX_STEP_S = 0.34
# Longest time from a drop to the probability of being on the ground that makes it a fall.
_DOWN_WITHIN_S = 2.5
STAYS_DOWN_S = 0.5
"""Time on the ground after the drop before a fall is reported."""

STAYS_LOW_S = 2.5
"""The same where the box has sunk and the posture stays unclear."""

# Probability that a fall seen by the box alone is one.
_SEEN_BY_BOX = 0.5
# A fall needs a person whose posture was clear at most so long before: of people who are too small
# or seen from straight above, nothing is known but a box that jumps.
_CLEAR_BEFORE_S = 5.0


class EventDetector:
    """Watches the postures of one track, the height of its hips, and its box."""

    def __init__(self) -> None:
        self._last_at: float | None = None
        self._lying, self._arms_raised = _Hysteresis(), _Hysteresis()
        self._down, self._clear = _Hysteresis(), _Hysteresis()
        self._clear_at = -math.inf
        self._drop, self._sink = DropDetector(), SinkDetector()
        self._rests = self._fallen = False
        self._down_s = 0.0
        """Seconds on the ground after a drop."""
        self._low_s = 0.0
        """Seconds in an unclear posture since the box sank."""

    def update(
        self,
        track_id: int,
        timestamp: float,
        shares: NDArray[np.float64],
        reliability: Reliability,
        hips: HipHeight | None = None,
        box: Box | None = None,
        *,
        posture: PostureName | None = None,
        rests: bool = False,
        alone: bool = True,
    ) -> tuple[Event, ...]:
        """Add a frame of the track and return what begins, ends or happens with it.

        ``shares`` ``(10,)`` are those of ``POSTURES`` at this frame. The reliability weights
        postures and gestures by ``body``, and being on the ground by ``person``. Hips are None
        where they are not seen; the box is of what is seen of the person. The posture is the
        track's, None if it is unclear; ``rests`` says whether the person is in a zone for resting,
        where lying is no event; ``alone`` whether no other person's box meets this one, which may
        then be of the part that the other leaves in view.
        """
        elapsed = 0.0 if self._last_at is None else min(timestamp - self._last_at, _MAX_STEP_S)
        step = reliability.body * elapsed
        self._last_at = timestamp

        def share(*postures: PostureName) -> float:
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
        self._rests = rests
        self._clear.update(timestamp, 0.0 if posture is None else 1.0, elapsed)
        if self._clear.holds:
            self._clear_at = timestamp
        if box is not None:
            self._sink.update(timestamp, box)
        fell = self._fell(timestamp, elapsed)
        level = self._down.level if fell else _SEEN_BY_BOX
        fell |= self._was_clear(timestamp) and self._stays_low(elapsed, posture, alone)
        return (*events, *happened("fell", "instant" if fell else None, level))

    def lost(
        self, track_id: int, timestamp: float, frame_shape: tuple[int, ...]
    ) -> tuple[Event, ...]:
        """The fall of a person who sank and is not seen any more, if they did."""
        ignored = self._fallen or self._rests or not self._was_clear(timestamp)
        if ignored or not self._sink.was_lost(frame_shape):
            return ()
        self._fallen = True
        return (Event("fell", track_id, "instant", timestamp, _SEEN_BY_BOX),)

    @property
    def has_fallen(self) -> bool:
        """Whether the person fell and was not seen to get up."""
        return self._fallen

    def unconfirmed(self, track_id: int) -> tuple[Event, ...]:
        """Events that had begun to show at the last frame but were not certain."""
        shown: dict[EventName, float] = {
            "arms_raised": 0.0 if self._arms_raised.holds else self._arms_raised.level,
            "lying": 0.0 if self._lying.holds else self._lying.level,
            "fell": self._down.level if self._may_have_fallen() else 0.0,
        }
        return tuple(
            Event(name, track_id, "unconfirmed", self._last_at or 0.0, level)
            for name, level in shown.items()
            if level >= _ENDS_BELOW
        )

    def _was_clear(self, timestamp: float) -> bool:
        """Whether the posture was clear a short time ago."""
        return timestamp - self._clear_at <= _CLEAR_BEFORE_S

    def _may_have_fallen(self) -> bool:
        dropped_at = self._drop.dropped_at
        if self._fallen or self._last_at is None or dropped_at is None:
            return False
        return self._down_s > 0 or self._last_at - dropped_at <= _DOWN_WITHIN_S

    def _fell(self, timestamp: float, elapsed: float) -> bool:
        """Whether a fall has become certain; true only once until the person is up again."""
        drop, level = self._drop, self._down.level
        if level < _ENDS_BELOW and self._sink.sunk_at is None:
            self._fallen = False
        if drop.dropped_at is None or level < drop.min_on_ground():
            self._down_s = 0.0
            return False
        if self._down_s == 0.0 and timestamp - drop.dropped_at > _DOWN_WITHIN_S:
            return False
        self._down_s += elapsed
        if self._fallen or self._down_s < STAYS_DOWN_S or not self._was_clear(timestamp):
            return False
        self._fallen = True
        return True

    def _stays_low(self, elapsed: float, posture: PostureName | None, alone: bool) -> bool:
        """Whether the box has sunk and stays low in no posture that explains it; true only once."""
        unclear = posture is None or (posture == "sitting" and self._sink.is_below_seats)
        if self._sink.sunk_at is None or not unclear or not alone or self._rests:
            self._low_s = 0.0
            return False
        self._low_s += elapsed
        if self._fallen or self._low_s < STAYS_LOW_S:
            return False
        self._fallen = True
        return True
