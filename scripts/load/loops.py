"""Open and closed loops of requests [1]_.

A client that waits for each answer before it sends the next request (a closed loop) slows down
with the server, and so can never overload it. An open loop sends at given times.

References
----------
.. [1] B. Schroeder, A. Wierman, M. Harchol-Balter, "Open Versus Closed: A Cautionary Tale",
   NSDI 2006.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from http.client import HTTPException

from scripts.load.client import Call, Client

MAX_CONNECTIONS = 400
"""While this many requests are unanswered, further ones are not sent, but counted."""


@dataclass(frozen=True)
class Answer:
    """Status of an answer, milliseconds to its last byte, and whether it says when to come back."""

    status: int
    ms: float
    retry_after: bool


@dataclass
class Tally:
    """Outcome of the requests of one run.

    ``unsent`` for want of connections, ``broken`` ones, ``seconds`` from the first request to the
    last answer. ``late_ms`` is the delay of each request after its time: large values mean that the
    client was the bottleneck.
    """

    answers: list[Answer] = field(default_factory=list)
    unsent: int = 0
    broken: int = 0
    seconds: float = 0.0
    late_ms: list[float] = field(default_factory=list)

    def of(self, status: int) -> list[Answer]:
        """Return the answers with a status."""
        return [answer for answer in self.answers if answer.status == status]


class _Loop:
    """Sends calls in turn over idle or new connections."""

    def __init__(self, url: str, calls: list[Call]) -> None:
        self._url = url
        self._calls = itertools.cycle(calls)
        self._idle: list[Client] = []
        self._threads = ThreadPoolExecutor(MAX_CONNECTIONS)
        self._tally = Tally()

    async def _send(self) -> None:
        client = self._idle.pop() if self._idle else Client(self._url)
        loop = asyncio.get_running_loop()
        try:
            answer = await loop.run_in_executor(self._threads, _timed, client, next(self._calls))
        except (OSError, HTTPException):
            self._tally.broken += 1
            return
        self._tally.answers.append(answer)
        self._idle.append(client)

    def _end(self, started: float) -> Tally:
        self._tally.seconds = time.perf_counter() - started
        for client in self._idle:
            client.close()
        self._threads.shutdown()
        return self._tally


def _timed(client: Client, call: Call) -> Answer:
    started = time.perf_counter()
    status, headers, _ = client.exchange(call)
    return Answer(status, (time.perf_counter() - started) * 1000, "Retry-After" in headers)


class OpenLoop(_Loop):
    """Sends calls at given times."""

    async def run(self, times_s: Iterable[float]) -> Tally:
        """Send a request at each of the times (seconds from now, ascending)."""
        started = time.perf_counter()
        unanswered: set[asyncio.Task[None]] = set()
        for at in times_s:
            await asyncio.sleep(max(0.0, started + at - time.perf_counter()))
            self._tally.late_ms.append((time.perf_counter() - started - at) * 1000)
            if len(unanswered) >= MAX_CONNECTIONS:
                self._tally.unsent += 1
                continue
            task = asyncio.create_task(self._send())
            unanswered.add(task)
            task.add_done_callback(unanswered.discard)
        await asyncio.gather(*unanswered)
        return self._end(started)


class ClosedLoop(_Loop):
    """Keeps a number of requests in flight: as much as the server carries, and no more."""

    async def run(self, in_flight: int, seconds: float) -> Tally:
        """Send the next request as soon as one is answered."""
        started = time.perf_counter()

        async def send_until_end() -> None:
            while time.perf_counter() < started + seconds:
                await self._send()

        await asyncio.gather(*(send_until_end() for _ in range(in_flight)))
        return self._end(started)
