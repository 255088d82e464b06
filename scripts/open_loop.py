"""A client that keeps to its timetable whether or not the server keeps up, over raw sockets.

A client that waits for each answer before it sends the next request slows down with the
server, and so can never overload it. This one sends at the times it was given, each request
over a kept-alive connection that is idle, or over a new one.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from scripts.raw_client import Call, header, request_bytes, whole_answer

MAX_CONNECTIONS = 400
"""Arrivals that find so many requests unanswered are not sent, but counted."""

GIVE_UP_S = 30.0


@dataclass(frozen=True)
class Answer:
    """One answered request.

    Parameters
    ----------
    status : int
    ms : float
        From the moment it was handed to the socket to the last byte of the answer.
    retry_after : bool
        Whether the answer says when to come back.
    """

    status: int
    ms: float
    retry_after: bool


@dataclass
class Tally:
    """What became of the requests of one run.

    Parameters
    ----------
    seconds : float
        From the first request to the last answer.
    late_ms : list of float
        How long after its time each request was sent: where this is much, the client was
        the bottleneck.
    """

    answers: list[Answer] = field(default_factory=list)
    unsent: int = 0
    broken: int = 0
    seconds: float = 0.0
    late_ms: list[float] = field(default_factory=list)

    def of(self, status: int) -> list[Answer]:
        """Return the answers with a status."""
        return [answer for answer in self.answers if answer.status == status]


class _Connection(asyncio.Protocol):
    """One connection: a request at a time, and a call when its answer is complete."""

    def __init__(self, done: Callable[[_Connection, Answer | None], None]) -> None:
        self._done = done
        self._transport: asyncio.Transport | None = None
        self._received = bytearray()
        self._started: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def send(self, request: bytes) -> None:
        """Start the clock and write."""
        assert self._transport is not None
        self._received.clear()
        self._started = time.perf_counter()
        self._transport.write(request)

    def data_received(self, data: bytes) -> None:
        self._received += data
        answer = whole_answer(self._received)
        if answer is not None and self._started is not None:
            head, _ = answer
            ms = (time.perf_counter() - self._started) * 1000
            self._started = None
            retry_after = header(head, b"retry-after") is not None
            self._done(self, Answer(int(head[9:12]), ms, retry_after))

    def connection_lost(self, error: Exception | None) -> None:
        if self._started is not None:
            self._started = None
            self._done(self, None)
        self._transport = None

    @property
    def usable(self) -> bool:
        """Whether the server has left it open."""
        return self._transport is not None and not self._transport.is_closing()

    def close(self) -> None:
        """Hang up."""
        if self._transport is not None:
            self._transport.abort()


class _Sender:
    """Connections, the requests that go over them in turn, and what became of each."""

    def __init__(self, url: str, calls: list[Call]) -> None:
        parts = urlsplit(url)
        self._address = (parts.hostname or "", parts.port or 80)
        self._requests = itertools.cycle([request_bytes(call) for call in calls])
        self._idle: list[_Connection] = []
        self._open = 0
        self._connecting: set[asyncio.Task[None]] = set()
        self._tally = Tally()

    def _send(self) -> None:
        self._open += 1
        while self._idle and not self._idle[-1].usable:
            self._idle.pop()
        if self._idle:
            self._idle.pop().send(next(self._requests))
            return
        task = asyncio.get_running_loop().create_task(self._send_anew())
        self._connecting.add(task)
        task.add_done_callback(self._connecting.discard)

    async def _send_anew(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            _, connection = await loop.create_connection(
                lambda: _Connection(self._done), *self._address
            )
        except OSError:
            self._open -= 1
            self._tally.broken += 1
            return
        connection.send(next(self._requests))

    def _done(self, connection: _Connection, answer: Answer | None) -> None:
        self._open -= 1
        if answer is None:
            self._tally.broken += 1
            return
        self._tally.answers.append(answer)
        self._idle.append(connection)

    async def _drain(self) -> None:
        """Wait for what is still unanswered, and hang up."""
        until = time.perf_counter() + GIVE_UP_S
        while self._open and time.perf_counter() < until:
            await asyncio.sleep(0.01)
        self._tally.broken += self._open
        for connection in self._idle:
            connection.close()


class OpenLoop(_Sender):
    """Sends calls at given times.

    Parameters
    ----------
    url : str
    calls : list of Call
        Sent in turn.
    """

    async def run(self, times_s: Iterable[float]) -> Tally:
        """Send a request at each of the times (seconds from now, ascending)."""
        started = time.perf_counter()
        for at in times_s:
            # Even where there is nothing to wait for, answers must be read.
            await asyncio.sleep(max(0.0, started + at - time.perf_counter()))
            self._tally.late_ms.append((time.perf_counter() - started - at) * 1000)
            if self._open < MAX_CONNECTIONS:
                self._send()
            else:
                self._tally.unsent += 1
        await self._drain()
        self._tally.seconds = time.perf_counter() - started
        return self._tally


class ClosedLoop(_Sender):
    """Keeps a number of requests in flight: as much as the server carries, and no more.

    Parameters
    ----------
    url : str
    calls : list of Call
        Sent in turn.
    """

    _until = 0.0

    async def run(self, in_flight: int, seconds: float) -> Tally:
        """Send the next request as soon as one is answered."""
        started = time.perf_counter()
        self._until = started + seconds
        for _ in range(in_flight):
            self._send()
        await asyncio.sleep(seconds)
        self._tally.seconds = time.perf_counter() - started
        within = len(self._tally.answers)
        await self._drain()
        del self._tally.answers[within:]
        return self._tally

    def _done(self, connection: _Connection, answer: Answer | None) -> None:
        super()._done(connection, answer)
        if time.perf_counter() < self._until:
            self._send()
