"""Requests sent in the background while a test does something else."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from http.client import HTTPException

from scripts.load.client import Call, Client


@dataclass(frozen=True)
class Reply:
    """A whole answer, and when it came (monotonic seconds)."""

    at: float
    status: int
    retry_after: str | None
    body: bytes


class BackgroundLoop:
    """Clients that send calls beside whatever else is done; who is refused waits a moment."""

    def __init__(self, url: str, calls: list[Call], clients: int = 2) -> None:
        self.replies: list[Reply] = []
        self.broken = 0
        self._url, self._calls = url, calls
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._send, args=(i,)) for i in range(clients)]

    def __enter__(self) -> BackgroundLoop:
        """Start."""
        self.started = time.monotonic()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        """End."""
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def _send(self, first: int) -> None:
        client, number = Client(self._url), first
        while not self._ended.is_set():
            try:
                status, headers, body = client.exchange(self._calls[number % len(self._calls)])
            except (OSError, HTTPException):
                self.broken += 1
                continue
            number += 1
            self.replies.append(Reply(time.monotonic(), status, headers["Retry-After"], body))
            if status == 503:
                time.sleep(0.1)

    def first(self, status: int, after: float, timeout_s: float = 60) -> float:
        """Wait for the first answer of a status after a time; return when it came."""
        while time.monotonic() < after + timeout_s:
            for reply in self.replies:
                if reply.status == status and reply.at > after:
                    return reply.at
            time.sleep(0.01)
        raise TimeoutError(f"no answer of status {status} came in {timeout_s:g} s")
