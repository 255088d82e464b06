"""The fair queue of frames: admission and order.

Admission
    A frame is admitted while its expected wait, from the recent durations of each kind of work,
    is short enough. A refusal says when to come back.
Order
    Callers share the threads' time equally, however much each of them sends, by fair queueing [1]_:
    short work overtakes the long work of other callers. Frames of one caller keep their order.
Cameras
    One frame of a live camera is processed at a time, and one waits. A newer frame replaces the
    waiting one, since a late reply is worth less than a reply to a newer frame.

The queue is used by the event loop's thread only and needs no lock.

References
----------
.. [1] A. Demers, S. Keshav, S. Shenker, "Analysis and Simulation of a Fair Queueing Algorithm",
   SIGCOMM 1989.
"""

import asyncio
import heapq
import itertools
import math
import time
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field

from app.scheduling.job import BusyError

# Share of the longest wait up to which frames are admitted; the rest is the estimates' error.
ADMIT_SHARE = 0.75
_MAX_RETRY_S = 30


class OverloadedError(BusyError):
    """The frame would wait, or has waited, longer than allowed."""

    reason = "overloaded"


class SupersededError(BusyError):
    """A newer frame of the same camera has replaced this one."""

    reason = "superseded"

    def __init__(self) -> None:
        newer = "a newer frame of this camera has taken the place of this one, which still waited"
        super().__init__(newer, retry_after_s=None)


class ShutdownError(BusyError):
    """The service is being stopped."""

    reason = "shutdown"

    def __init__(self) -> None:
        super().__init__("the service is being stopped; try again shortly")


@dataclass(eq=False)
class Ticket:
    """A frame in the queue: its number in order of arrival, and the live camera that took it.

    The result of ``begun`` is None once the frame may begin, or a function that makes the error if
    it never will: a stored exception would keep the frame alive through its traceback.
    """

    caller: Hashable
    kind: Hashable
    number: int
    camera: Hashable = None
    begun: asyncio.Future[Callable[[], BusyError] | None] = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )
    began_at: float = 0.0


class FairQueue:
    """Frames that wait for a thread, ``max_wait_s`` at most, or are being processed."""

    def __init__(
        self, threads: int, max_wait_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.threads, self.max_wait_s = threads, max_wait_s
        self._clock = clock
        self._waiting: list[Ticket] = []
        self._working: list[Ticket] = []
        # Virtual time: the seconds of work that a caller who always has a frame waiting has
        # received; then, for each caller, the virtual finish of its last frame and its kind.
        self._virtual_s = 0.0
        self._finish_s: dict[Hashable, float] = {}
        self._kinds: dict[Hashable, Hashable] = {}
        self._last_kind: Hashable = None
        self._duration_s: dict[Hashable, float] = {}
        self._numbers = itertools.count()
        self._closed = False

    @property
    def working(self) -> int:
        """Number of frames being processed."""
        return len(self._working)

    @property
    def in_flight(self) -> int:
        """Number of frames that wait or are being processed."""
        return len(self._waiting) + len(self._working)

    def load(self) -> float:
        """Return a new caller's expected wait as a share of the longest that is admitted."""
        return self._wait_s(object(), self._last_kind) / (ADMIT_SHARE * self.max_wait_s)

    def check(self, caller: Hashable, camera: Hashable = None) -> None:
        """Raise :class:`OverloadedError` if :meth:`enqueue` would, before the frame is received."""
        if self._waiting_of(camera) is None:
            # The content is not known yet. It is probably of the kind that this caller, or else any
            # caller, sent last.
            self._admit(caller, self._kinds.get(caller, self._last_kind))

    def enqueue(
        self,
        caller: Hashable,
        kind: Hashable,
        camera: Hashable = None,
        *,
        unbounded_wait: bool = False,
    ) -> Ticket:
        """Add a frame; raise :class:`OverloadedError` if it would wait for too long.

        Frames of one kind take about the same time. A waiting frame of the same live camera is
        superseded. With ``unbounded_wait``, the frame is admitted however long it has to wait.
        """
        if (older := self._waiting_of(camera)) is not None:
            number = older.number
            self._waiting.remove(older)
            older.begun.set_result(SupersededError)
        else:
            number = next(self._numbers)
            if not unbounded_wait:
                self._admit(caller, kind)
        self._finish_s[caller] = self._virtual_start_s(caller)
        ticket = Ticket(caller, kind, number, camera)
        self._waiting.append(ticket)
        self._advance()
        return ticket

    def expire(self, ticket: Ticket) -> OverloadedError:
        """Remove a frame that has waited as long as is allowed, and return the error to raise."""
        self._waiting.remove(ticket)
        return self._overloaded(self._wait_s(ticket.caller, ticket.kind))

    def release(self, ticket: Ticket, *, worked: bool = False) -> None:
        """Remove a frame, if it has not been removed before.

        ``worked`` is whether the work was completed, so that its duration is typical of its kind.
        """
        if ticket in self._working:
            self._working.remove(ticket)
            if worked:
                took_s, kind = self._clock() - ticket.began_at, ticket.kind
                before_s = self._duration_s.get(kind, took_s)
                # Weight of the newest duration in the running mean.
                self._duration_s[kind] = before_s + 0.2 * (took_s - before_s)
        elif ticket in self._waiting:
            self._waiting.remove(ticket)
        self._advance()

    def close(self) -> None:
        self._closed = True
        for ticket in self._waiting:
            ticket.begun.set_result(ShutdownError)
        self._waiting.clear()

    def _advance(self) -> None:
        while self.working < self.threads and not self._closed:
            busy = {ticket.camera for ticket in self._working} - {None}
            for finish_s, ticket in self._ordered(self._waiting):
                if ticket.camera not in busy:
                    self._begin(ticket, finish_s)
                    break
            else:
                break

    def _begin(self, ticket: Ticket, finish_s: float) -> None:
        caller, kind = ticket.caller, ticket.kind
        self._waiting.remove(ticket)
        self._working.append(ticket)
        ticket.began_at = self._clock()
        ticket.begun.set_result(None)
        self._virtual_s = max(self._virtual_s, finish_s - self._estimate_s(kind))
        self._finish_s[caller] = finish_s
        self._kinds[caller] = self._last_kind = kind
        # Above this, callers without a waiting frame are forgotten.
        if len(self._finish_s) > 1000:
            waiting = {ticket.caller for ticket in self._waiting}
            self._finish_s = {c: s for c, s in self._finish_s.items() if c in waiting}
            self._kinds = {c: kind for c, kind in self._kinds.items() if c in waiting}

    def _ordered(self, tickets: Iterable[Ticket]) -> list[tuple[float, Ticket]]:
        """Return the virtual finish of each frame, and the frame, in the order of service."""
        finish_s: dict[Hashable, float] = {}
        ordered = []
        for ticket in sorted(tickets, key=lambda ticket: ticket.number):
            caller = ticket.caller
            start_s = finish_s.get(caller) or self._virtual_start_s(caller)
            finish_s[caller] = start_s + self._estimate_s(ticket.kind)
            ordered.append((finish_s[caller], ticket))
        return sorted(ordered, key=lambda pair: (pair[0], pair[1].number))

    def _virtual_start_s(self, caller: Hashable) -> float:
        """Return the virtual start of a caller's next frame; idle time gives no credit."""
        finish_s = self._finish_s.get(caller, 0.0)
        waits = any(ticket.caller == caller for ticket in self._waiting)
        return finish_s if waits else max(finish_s, self._virtual_s)

    def _waiting_of(self, camera: Hashable) -> Ticket | None:
        if camera is None:
            return None
        return next((ticket for ticket in self._waiting if ticket.camera == camera), None)

    def _admit(self, caller: Hashable, kind: Hashable) -> None:
        if self.working < self.threads and not self._waiting:
            return
        wait_s = self._wait_s(caller, kind)
        if wait_s > ADMIT_SHARE * self.max_wait_s:
            raise self._overloaded(wait_s)

    def _overloaded(self, wait_s: float) -> OverloadedError:
        excess_s = wait_s - ADMIT_SHARE * self.max_wait_s
        after_s = min(max(1, math.ceil(excess_s)), _MAX_RETRY_S)
        return OverloadedError(
            f"the service is working to capacity; try again in {after_s} s", retry_after_s=after_s
        )

    def _wait_s(self, caller: Hashable, kind: Hashable) -> float:
        """Return the expected seconds until a thread is free for a caller's next frame."""
        now = self._clock()
        free = [0.0] * (self.threads - self.working) + [
            max(0.0, ticket.began_at + self._estimate_s(ticket.kind) - now)
            for ticket in self._working
        ]
        heapq.heapify(free)
        newest = Ticket(caller, kind, next(self._numbers))
        for _, ticket in self._ordered([newest, *self._waiting]):
            if ticket is newest:
                break
            heapq.heapreplace(free, free[0] + self._estimate_s(ticket.kind))
        return free[0]

    def _estimate_s(self, kind: Hashable) -> float:
        # Assumed duration of a kind of work that has not been measured yet.
        return self._duration_s.get(kind, 0.1)
