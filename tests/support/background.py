"""Requests sent in the background while a test does something else."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import httpx


@dataclass(frozen=True)
class Reply:
    """A complete answer, and when it came (monotonic seconds)."""

    at: float
    response: httpx.Response

    @property
    def status(self) -> int:
        return self.response.status_code


class BackgroundLoop:
    """Clients that repeat a request in the background, after a pause where it is refused."""

    def __init__(
        self, url: str, request: Callable[[httpx.Client], httpx.Response], clients: int = 2
    ) -> None:
        self.replies: list[Reply] = []
        self.broken = 0
        self._url, self._request = url, request
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._repeat) for _ in range(clients)]

    def __enter__(self) -> BackgroundLoop:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()

    def _repeat(self) -> None:
        with httpx.Client(base_url=self._url, timeout=30) as client:
            while not self._ended.is_set():
                try:
                    response = self._request(client)
                except httpx.TransportError:
                    self.broken += 1
                    continue
                self.replies.append(Reply(time.monotonic(), response))
                if response.status_code == 503:
                    time.sleep(0.1)

    def wait_for(self, status: int, timeout_s: float = 10) -> None:
        """Wait for an answer of a status that comes from now on."""
        began = time.monotonic()
        while time.monotonic() < began + timeout_s:
            if any(reply.status == status and reply.at > began for reply in self.replies):
                return
            time.sleep(0.01)
        raise TimeoutError(f"no answer of status {status} came in {timeout_s:g} s")
