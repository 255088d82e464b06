"""A client with a kept-alive connection, and open and closed loops of its requests [1]_.

A client that waits for each answer before it sends the next request (a closed loop) slows down
with the server, and so can never overload it. An open loop sends at given times.

References
----------
.. [1] B. Schroeder, A. Wierman, M. Harchol-Balter, "Open Versus Closed: A Cautionary Tale",
   NSDI 2006.
"""

from __future__ import annotations

import re
import select
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from http.client import HTTPConnection, HTTPMessage
from urllib.parse import urlsplit

import httpx
import numpy as np

MAX_CONNECTIONS = 400
"""While this many requests are unanswered, further ones are not sent, but counted."""

PROBE_EVERY_S = 0.02
PROBE_P99_MS = 50.0

_TEXT_FIELDS = ("api_key", "boxes", "min_confidence", "timestamp")


@dataclass(frozen=True)
class Call:
    """One request; the form fields in ``parts`` that hold images are sent as files."""

    method: str
    path: str
    parts: dict[str, bytes] = field(default_factory=dict)
    headers: dict[str, str] = field(default_factory=dict)

    @cached_property
    def message(self) -> tuple[bytes, dict[str, str]]:
        """Body and headers, encoded once."""
        if not self.parts:
            return b"", self.headers
        files = {
            name: (None if name in _TEXT_FIELDS else "image", value)
            for name, value in self.parts.items()
        }
        request = httpx.Request(self.method, "http://localhost", files=files)
        return request.read(), {**self.headers, "Content-Type": request.headers["Content-Type"]}


class Client:
    """Sends calls over one connection, opened again if the server has closed it.

    ``http.client`` takes 0.4 ms of processor time a request, httpx 1.4 ms. ``timeout_s`` is the
    longest silence of the server, ``source`` the address of this machine to send from.
    """

    def __init__(self, url: str, timeout_s: float = 30, source: str | None = None) -> None:
        address = (source, 0) if source else None
        self._connection = HTTPConnection(
            urlsplit(url).netloc, timeout=timeout_s, source_address=address
        )

    def send(self, call: Call) -> tuple[int, bytes]:
        """Return status and body."""
        status, _, body = self.exchange(call)
        return status, body

    def exchange(self, call: Call) -> tuple[int, HTTPMessage, bytes]:
        """Return status, headers and body.

        Raises
        ------
        OSError, http.client.HTTPException
            If the server closes the connection before its answer is complete, or is silent.
        """
        try:
            self._request(call)
            response = self._connection.getresponse()
            return response.status, response.headers, response.read()
        except BaseException:
            self.close()
            raise

    def hang_up(self, call: Call) -> None:
        """Send a request and close the connection without waiting for the answer."""
        self._request(call)
        self.close()

    def close(self) -> None:
        """Close the connection; the next call opens another."""
        self._connection.close()

    def _request(self, call: Call) -> None:
        # Between two answers a socket is readable only if the server has closed it.
        if self._connection.sock and select.select([self._connection.sock], [], [], 0)[0]:
            self.close()
        self._connection.request(call.method, call.path, *call.message)


def answer(client: Client, call: Call) -> bytes:
    """Return the body of an answer that must be 200."""
    status, body = client.send(call)
    if status != 200:
        raise ValueError(f"expected status 200, got {status}: {body.decode(errors='replace')}")
    return body


@dataclass(frozen=True)
class Request:
    """A call, its kind and number, and whether the client hangs up before the answer."""

    call: Call
    kind: str = ""
    number: int = 0
    hang_up: bool = False


@dataclass(frozen=True)
class Answer:
    """Status of an answer, milliseconds to its last byte, and its ``Retry-After`` in seconds."""

    request: Request
    status: int
    ms: float
    retry_after_s: float | None


@dataclass
class Tally:
    """Outcome of the requests of one client, or of all clients of a run.

    ``broken`` names the errors of connections. Requests are ``unsent`` for want of connections, and
    ``late_ms`` after their time: large values mean that the client was the bottleneck. ``seconds``
    pass from the first request to the last answer.
    """

    answers: list[Answer] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    late_ms: list[float] = field(default_factory=list)
    unsent: int = 0
    seconds: float = 0.0

    @classmethod
    def of(cls, tallies: Sequence[Tally]) -> Tally:
        """Return the tally of several clients."""
        return cls(
            [answer for one in tallies for answer in one.answers],
            [error for one in tallies for error in one.broken],
            seconds=max(one.seconds for one in tallies),
        )

    def with_status(self, status: int) -> list[Answer]:
        """Return the answers with a status."""
        return [answer for answer in self.answers if answer.status == status]

    def statuses(self) -> dict[str, int]:
        """Count the answers by status."""
        counts = Counter(answer.status for answer in self.answers)
        return {str(status): counts[status] for status in sorted(counts)}

    def send(self, client: Client, request: Request) -> Answer | None:
        """Send a request and count its answer; None if there is none."""
        started = time.perf_counter()
        try:
            if request.hang_up:
                client.hang_up(request.call)
                return None
            status, headers, _ = client.exchange(request.call)
        except Exception as error:  # Every error is counted and shown.
            self.broken.append(f"{request.kind} {type(error).__name__}".strip())
            return None
        after = headers["Retry-After"]
        ms = (time.perf_counter() - started) * 1000
        found = Answer(request, status, ms, None if after is None else float(after))
        self.answers.append(found)
        return found


def closed_loop(
    clients: Sequence[tuple[Client, Iterator[Request]]],
    seconds: float = float("inf"),
    *,
    patient: bool = False,
) -> list[Tally]:
    """Let each client send its requests, the next when the last is answered; return their tallies.

    Patient clients send a refused request again after its ``Retry-After``.
    """
    started = time.perf_counter()
    until = started + seconds

    def run(client: Client, requests: Iterator[Request]) -> Tally:
        tally = Tally()
        while time.perf_counter() < until and (request := next(requests, None)) is not None:
            found = tally.send(client, request)
            while patient and found is not None and found.status == 503:
                left = until - time.perf_counter()
                time.sleep(max(0.0, min(found.retry_after_s or 0.0, left)))
                found = tally.send(client, request) if time.perf_counter() < until else None
        client.close()
        tally.seconds = time.perf_counter() - started
        return tally

    with ThreadPoolExecutor(len(clients)) as threads:
        return list(threads.map(run, *zip(*clients, strict=True)))


def open_loop(url: str, requests: Iterator[Request], times_s: Iterable[float]) -> Tally:
    """Send a request at each of the times (seconds from now, ascending), answered or not."""
    tally, idle = Tally(), list[Client]()
    free = threading.Semaphore(MAX_CONNECTIONS)

    def send(request: Request) -> None:
        try:
            client = idle.pop()
        except IndexError:
            client = Client(url)
        tally.send(client, request)
        idle.append(client)
        free.release()

    started = time.perf_counter()
    with ThreadPoolExecutor(MAX_CONNECTIONS) as threads:
        for at in times_s:
            time.sleep(max(0.0, started + at - time.perf_counter()))
            tally.late_ms.append((time.perf_counter() - started - at) * 1000)
            if free.acquire(blocking=False):
                threads.submit(send, next(requests))
            else:
                tally.unsent += 1
    tally.seconds = time.perf_counter() - started
    for client in idle:
        client.close()
    return tally


def probe(url: str, seconds: float) -> list[float]:
    """Ask ``/healthz`` at fixed times, each over a new connection; return milliseconds."""
    times = []
    started = time.perf_counter()
    for at in np.arange(0.0, seconds, PROBE_EVERY_S):
        time.sleep(max(0.0, started + at - time.perf_counter()))
        asked = time.perf_counter()
        status, _ = Client(url).send(Call("GET", "/healthz"))
        if status != 200:
            raise RuntimeError(f"/healthz answered {status}")
        times.append((time.perf_counter() - asked) * 1000)
    return times


def metric(url: str, sample: str) -> float:
    """Return the value of a sample of ``/metrics``; 0 where there is none yet."""
    _, metrics = Client(url).send(Call("GET", "/metrics"))
    found = re.search(rf"^{re.escape(sample)} (\S+)", metrics.decode(), re.MULTILINE)
    return float(found.group(1)) if found else 0.0
