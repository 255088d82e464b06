"""A client with a kept-alive connection, and a loop of clients that wait for each answer."""

import select
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from http.client import HTTPConnection, HTTPMessage
from urllib.parse import urlsplit

import httpx

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
    longest silence of the server.
    """

    def __init__(self, url: str, timeout_s: float = 30) -> None:
        self._connection = HTTPConnection(urlsplit(url).netloc, timeout=timeout_s)

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
    """Outcome of the requests of all clients of a run.

    ``broken`` names the errors of connections. ``seconds`` pass from the first request to the last
    answer.
    """

    answers: list[Answer] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def with_status(self, status: int) -> list[Answer]:
        """Return the answers with a status."""
        return [answer for answer in self.answers if answer.status == status]

    def statuses(self) -> dict[str, int]:
        """Count the answers by status."""
        counts = Counter(answer.status for answer in self.answers)
        return {str(status): counts[status] for status in sorted(counts)}

    def send(self, client: Client, request: Request) -> None:
        """Send a request and count its answer."""
        started = time.perf_counter()
        try:
            if request.hang_up:
                client.hang_up(request.call)
                return
            status, headers, _ = client.exchange(request.call)
        except Exception as error:  # Every error is counted and shown.
            self.broken.append(f"{request.kind} {type(error).__name__}".strip())
            return
        after = headers["Retry-After"]
        ms = (time.perf_counter() - started) * 1000
        self.answers.append(Answer(request, status, ms, None if after is None else float(after)))


def closed_loop(
    clients: Sequence[tuple[Client, Iterator[Request]]], seconds: float = float("inf")
) -> Tally:
    """Let each client send its requests, the next when the last is answered."""
    tally, started = Tally(), time.perf_counter()

    def run(client: Client, requests: Iterator[Request]) -> None:
        while time.perf_counter() < started + seconds:
            if (request := next(requests, None)) is None:
                break
            tally.send(client, request)
        client.close()

    with ThreadPoolExecutor(len(clients)) as threads:
        list(threads.map(run, *zip(*clients, strict=True)))
    tally.seconds = time.perf_counter() - started
    return tally
