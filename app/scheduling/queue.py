"""The line of frames that wait for a thread: who is admitted, whose turn is next, who comes back.

Admission
    A frame is let in while it will probably wait no longer than allowed, by the time that work of
    each kind has taken of late. Whoever is refused is told when to come back, and until then keeps
    the place in the line: else those who have just been answered would always be there first.
Order
    Callers share the threads' time alike, however much each of them sends, by fair queueing [1]_:
    short work overtakes the long work of others. One caller's frames keep their order.
Cameras
    One frame of a live camera is worked on at a time, and one waits: a newer one takes its place,
    since a late answer is worth less than one to a newer frame.

All of it happens on the thread that answers requests, so nothing is locked.

References
----------
.. [1] A. Demers, S. Keshav, S. Shenker, "Analysis and Simulation of a Fair Queueing Algorithm",
   SIGCOMM 1989.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import math
import time
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple, TypeVar

from app.scheduling.job import BusyError

ADMIT_SHARE = 0.75
"""Share of the allowed wait for which frames are admitted; estimates err by about the rest."""

_UNMEASURED_S = 0.1
# Weight of the newest duration in the running mean.
_NEWEST_WEIGHT = 0.2
_KEPT_FOR_S = 2.0  # After the moment at which a caller was told to come back.
_EARLY_S = 0.05  # Clocks differ.
_MOST_KEPT = 64
_MOST_CALLERS = 1000  # Beyond, those are forgotten who have nothing waiting.
_LONGEST_RETRY_S = 30

_SUPERSEDED = "a newer frame of this camera has taken the place of this one, which still waited"
_FULL = "the service is working to capacity; try again in {} s"


class OverloadedError(BusyError):
    """The frame would wait, or has waited, for longer than allowed."""

    reason = "overloaded"


class SupersededError(BusyError):
    """A newer frame of the same camera has taken the place of this one."""

    reason = "superseded"

    def __init__(self) -> None:
        super().__init__(_SUPERSEDED, retry_after_s=None)


class ShutdownError(BusyError):
    """The service is being stopped."""

    reason = "shutdown"

    def __init__(self) -> None:
        super().__init__("the service is being stopped; try again shortly")


class Sender(NamedTuple):
    """Who sends a frame.

    Parameters
    ----------
    caller : hashable
        Callers share the threads alike.
    connection : hashable, optional
        Tells the clients of one caller apart; None where that cannot be told.
    """

    caller: Hashable
    connection: Hashable = None


@dataclass(eq=False)
class _Entry:
    """A place in the line.

    Parameters
    ----------
    sender : Sender
    kind : hashable
        Frames of one kind take about as long.
    number : int
        In order of arrival.
    """

    sender: Sender
    kind: Hashable
    number: int


class Turn(_Entry):
    """The place of a frame.

    Parameters
    ----------
    sender, kind, number
        See :class:`_Entry`.
    camera : hashable
        The live camera it is of, None if it is of none.

    Attributes
    ----------
    begun : asyncio.Future
        Done when its turn has come, or when it will not come: what makes the error then. An error
        that the future held would keep the frame that was to be worked on.
    """

    def __init__(self, sender: Sender, kind: Hashable, number: int, camera: Hashable) -> None:
        super().__init__(sender, kind, number)
        self.camera = camera
        self.begun: asyncio.Future[Callable[[], BusyError] | None]
        self.begun = asyncio.get_running_loop().create_future()
        self.began_at = 0.0


E = TypeVar("E", bound=_Entry)


@dataclass(eq=False)
class _Kept(_Entry):
    """The place of someone who was told to come back at a time."""

    due: float


class Line:
    """Frames that wait for one of a number of threads, or are worked on.

    Parameters
    ----------
    threads : int
    max_wait_s : float
        Longest wait of a frame.
    clock : callable
        Seconds, monotonic.
    """

    def __init__(
        self, threads: int, max_wait_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.threads, self.max_wait_s = threads, max_wait_s
        self._clock = clock
        self._waiting: list[Turn] = []
        self._working: list[Turn] = []
        self._kept: list[_Kept] = []
        # Work that each caller has had, on the clock of one who always has something waiting; and
        # the last kind of it.
        self._served_s: dict[Hashable, float] = {}
        self._kinds: dict[Hashable, Hashable] = {}
        self._last_kind: Hashable = None
        self._now_s = 0.0
        self._seconds: dict[Hashable, float] = {}
        self._numbers = itertools.count()
        self._closed = False

    @property
    def working(self) -> int:
        """Frames that are worked on."""
        return len(self._working)

    @property
    def inside(self) -> int:
        """Frames that wait or are worked on."""
        return len(self._waiting) + len(self._working)

    def fullness(self) -> float:
        """Wait of a newcomer's frame as a share of that from which frames are refused."""
        newcomer = _Entry(Sender(object()), self._last_kind, next(self._numbers))
        return self._wait_s(newcomer) / (ADMIT_SHARE * self.max_wait_s)

    def check(self, sender: Sender, camera: Hashable = None) -> None:
        """Raise :class:`OverloadedError` if :meth:`join` would, before the frame is received."""
        if self._waiting_of(camera) is None:
            # What it holds is not known yet: probably what its caller, or others, sent last.
            kind = self._kinds.get(sender.caller, self._last_kind)
            self._admit(self._entry_of(sender, kind), sender)

    def join(
        self, sender: Sender, kind: Hashable, camera: Hashable = None, *, patient: bool = False
    ) -> Turn:
        """Take a place in the line.

        Parameters
        ----------
        sender : Sender
        kind : hashable
            Frames of one kind take about as long.
        camera : hashable, optional
            A live camera: its frame that still waits is superseded.
        patient : bool
            Whether it waits for however long it takes.

        Raises
        ------
        OverloadedError
        """
        entry: _Entry | None = self._waiting_of(camera)
        if isinstance(entry, Turn):
            self._waiting.remove(entry)
            entry.begun.set_result(SupersededError)
        else:
            entry = self._entry_of(sender, kind)
            if not patient:
                self._admit(entry, sender)
        if isinstance(entry, _Kept):
            self._kept.remove(entry)
        self._served_s[sender.caller] = self._had_s(sender.caller)
        turn = Turn(sender, kind, entry.number, camera)
        self._waiting.append(turn)
        self._advance()
        return turn

    def give_up(self, turn: Turn) -> OverloadedError:
        """Make the error for a frame that has waited for as long as is allowed."""
        self._waiting.remove(turn)
        return self._come_back(turn, turn.sender)

    def leave(self, turn: Turn, *, worked: bool = False) -> None:
        """Leave the line; nothing happens if it has been left before.

        Parameters
        ----------
        turn : Turn
        worked : bool
            Whether it was worked on to the end, so that its duration says what the kind takes.
        """
        if turn in self._working:
            self._working.remove(turn)
            if worked:
                took_s = self._clock() - turn.began_at
                before = self._seconds.get(turn.kind, took_s)
                self._seconds[turn.kind] = before + _NEWEST_WEIGHT * (took_s - before)
        elif turn in self._waiting:
            self._waiting.remove(turn)
        self._advance()

    def close(self) -> None:
        """Drop what waits, and begin nothing more."""
        self._closed = True
        for turn in self._waiting:
            turn.begun.set_result(ShutdownError)
        self._waiting.clear()

    def _advance(self) -> None:
        """Begin what may be begun."""
        while self.working < self.threads and self._waiting and not self._closed:
            busy = {turn.camera for turn in self._working} - {None}
            for served_s, turn in self._ordered(self._waiting):
                if turn.camera not in busy:
                    self._begin(turn, served_s)
                    break
            else:
                break

    def _begin(self, turn: Turn, served_s: float) -> None:
        self._waiting.remove(turn)
        self._working.append(turn)
        turn.began_at = self._clock()
        turn.begun.set_result(None)
        self._now_s = max(self._now_s, served_s - self._estimate_s(turn.kind))
        self._served_s[turn.sender.caller] = served_s
        self._kinds[turn.sender.caller] = self._last_kind = turn.kind
        if len(self._served_s) > _MOST_CALLERS:
            waiting = {turn.sender.caller for turn in self._waiting}
            self._served_s = {c: s for c, s in self._served_s.items() if c in waiting}
            self._kinds = {c: kind for c, kind in self._kinds.items() if c in waiting}

    def _ordered(self, entries: Iterable[E]) -> list[tuple[float, E]]:
        """Return places in the order of their turns, each with what its caller has had after it."""
        had: dict[Hashable, float] = {}
        places = []
        for entry in sorted(entries, key=_number):
            caller = entry.sender.caller
            before = had.get(caller) or self._had_s(caller)
            had[caller] = before + self._estimate_s(entry.kind)
            places.append((had[caller], entry))
        return sorted(places, key=lambda place: (place[0], place[1].number))

    def _had_s(self, caller: Hashable) -> float:
        """What a caller has had so far; who had nothing waiting has no claim on the time since."""
        had_s = self._served_s.get(caller, 0.0)
        waits = any(turn.sender.caller == caller for turn in self._waiting)
        return had_s if waits else max(had_s, self._now_s)

    def _waiting_of(self, camera: Hashable) -> Turn | None:
        if camera is None:
            return None
        return next((turn for turn in self._waiting if turn.camera == camera), None)

    def _entry_of(self, sender: Sender, kind: Hashable) -> _Entry:
        """Return the sender's kept place, else one that its caller has and is due, else a new one.

        Not every client keeps its connection.
        """
        now = self._clock()
        self._kept = [kept for kept in self._kept if now < kept.due + _KEPT_FOR_S]
        own = [kept for kept in self._kept if kept.sender.caller == sender.caller]
        same = [kept for kept in own if sender.connection and kept.sender == sender]
        due = [kept for kept in own if now >= kept.due - _EARLY_S]
        return min(same or due, key=_number, default=_Entry(sender, kind, next(self._numbers)))

    def _admit(self, entry: _Entry, sender: Sender) -> None:
        if self.working < self.threads and not self._waiting:
            return
        if self._wait_s(entry) > ADMIT_SHARE * self.max_wait_s:
            raise self._come_back(entry, sender)

    def _come_back(self, entry: _Entry, sender: Sender) -> OverloadedError:
        """Keep a place, and say when the wait before it will be short enough."""
        excess_s = self._wait_s(entry) - ADMIT_SHARE * self.max_wait_s
        after_s = min(max(1, math.ceil(excess_s)), _LONGEST_RETRY_S)
        if isinstance(entry, _Kept):
            self._kept.remove(entry)
        if len(self._kept) < _MOST_KEPT:
            self._kept.append(_Kept(sender, entry.kind, entry.number, self._clock() + after_s))
        return OverloadedError(_FULL.format(after_s), retry_after_s=after_s)

    def _wait_s(self, entry: _Entry) -> float:
        """Seconds until a thread is free for a place, if all before it take what they usually do.

        Those who were told to come back count as if they were there.
        """
        now = self._clock()
        free = [
            max(0.0, turn.began_at + self._estimate_s(turn.kind) - now) for turn in self._working
        ]
        free += [0.0] * (self.threads - len(free))
        heapq.heapify(free)
        others = [other for other in (*self._waiting, *self._kept) if other is not entry]
        for _, other in self._ordered([entry, *others]):
            if other is entry:
                break
            heapq.heapreplace(free, free[0] + self._estimate_s(other.kind))
        return free[0]

    def _estimate_s(self, kind: Hashable) -> float:
        return self._seconds.get(kind, _UNMEASURED_S)


_number = attrgetter("number")
