"""Requests sent in the background while a test does something else."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import httpx


class BackgroundLoop:
    """Clients that repeat a request in the background, after a pause where it is refused."""

    def __init__(
        self, url: str, request: Callable[[httpx.Client], httpx.Response], clients: int = 2
    ) -> None:
        self.responses: list[httpx.Response] = []
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
                self.responses.append(response)
                if response.status_code == 503:
                    time.sleep(0.1)
