"""A client with a kept-alive connection, and the requests it sends."""

from __future__ import annotations

import select
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
