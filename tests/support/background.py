"""Requests sent in the background while a test does something else."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

import httpx


@dataclass(frozen=True)
class Reply:
    """A whole answer, and when it came (monotonic seconds)."""

    at: float
    status: int
    retry_after: str | None
    body: bytes


class BackgroundLoop:
    """Clients that post a form to ``/pose`` beside the test; a refused one waits a moment."""

    def __init__(self, url: str, files: Mapping[str, bytes], clients: int = 2) -> None:
        self.replies: list[Reply] = []
        self.broken = 0
        self._url, self._files = url, files
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._send) for _ in range(clients)]

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

    def _send(self) -> None:
        with httpx.Client(base_url=self._url, timeout=30) as client:
            while not self._ended.is_set():
                try:
                    answer = client.post("/pose", files=self._files)
                except httpx.TransportError:
                    self.broken += 1
                    continue
                retry_after = answer.headers.get("Retry-After")
                status = answer.status_code
                self.replies.append(Reply(time.monotonic(), status, retry_after, answer.content))
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
