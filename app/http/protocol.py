"""uvicorn's HTTP/1.1, with bounds on the head of a request and errors as problems.

It subclasses a private class of uvicorn, which is why uvicorn is pinned: neither uvicorn nor
httptools bounds the head, and the service may face clients without a proxy in between.
"""

from __future__ import annotations

import asyncio
import sys
from http import HTTPStatus
from typing import cast

import httptools
from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.http.errors import MEDIA_TYPE, ProblemError, problem_body
from app.http.routing import request_state


class _HeadTooLargeError(Exception):
    """The head of a request is complete, but larger than allowed."""


class HttpProtocol(HttpToolsProtocol):
    """uvicorn's protocol, with a timeout and a size limit for the head of a request.

    The head is the request line and the headers. A late or too large head closes the connection.
    """

    head_timeout_s = 10.0
    max_head_bytes = 16 * 1024

    _head_timer: asyncio.TimerHandle | None = None
    _head_begun = False
    _head_is_new = False
    _head_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for the first request."""
        super().connection_made(transport)
        self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Count the bytes of a head."""
        self._head_is_new = False
        super().data_received(data)
        if self.transport.is_closing():
            return
        if self._head_begun:
            # Bytes are counted here because the parser reports a header only once it is complete.
            # Bytes that arrive together with the beginning of the head may belong to the previous
            # request, so they are not counted.
            self._head_bytes += 0 if self._head_is_new else len(data)
            if self._head_bytes > self.max_head_bytes:
                self._refuse(self._head_too_large())
        elif self._head_timer is None and self._is_idle():
            self._wait_for_head()  # uvicorn has stopped its own timer.

    def shutdown(self) -> None:
        """Tell the current request that the service is being stopped, and finish it."""
        if not self._is_idle():
            request_state(cast(Scope, self.scope)).is_ending = True
        super().shutdown()

    def on_message_begin(self) -> None:
        """Start the timer and the count for a head."""
        self._wait_for_head()
        self._head_begun = self._head_is_new = True
        self._head_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Stop the timer and answer the request."""
        self._stop_waiting()
        self._head_begun = False
        if len(self.url) + sum(len(k) + len(v) for k, v in self.headers) > self.max_head_bytes:
            raise _HeadTooLargeError
        super().on_headers_complete()

    def send_400_response(self, msg: str) -> None:
        """Refuse bytes that are no request; called when the parser has raised an error."""
        error = sys.exc_info()[1]
        if error is not None and isinstance(error.__context__, _HeadTooLargeError):
            self._refuse(self._head_too_large())
        elif isinstance(error, httptools.HttpParserInvalidMethodError):
            self._refuse(ProblemError(501, "expected a method of HTTP, such as GET or POST"))
        else:
            self._refuse(ProblemError(400, "expected a request of HTTP/1.1, got something else"))

    def _wait_for_head(self) -> None:
        self._stop_waiting()
        self._head_timer = self.loop.call_later(self.head_timeout_s, self._head_is_late)

    def _stop_waiting(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _head_is_late(self) -> None:
        self._head_timer = None
        if self.transport.is_closing():
            return
        if not self._is_idle():
            self._wait_for_head()  # The previous request has not been answered yet.
        elif self._head_begun:
            late = f"expected all headers of the request within {self.head_timeout_s:g} seconds"
            self._refuse(ProblemError(408, late))
        else:
            self.transport.close()

    def _is_idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def _head_too_large(self) -> ProblemError:
        return ProblemError(
            431, f"expected headers of at most {self.max_head_bytes} bytes together"
        )

    def _refuse(self, problem: ProblemError) -> None:
        """Answer without the application, and close the connection."""
        body = problem_body(problem)
        head = (
            f"HTTP/1.1 {problem.status} {HTTPStatus(problem.status).phrase}\r\n"
            f"content-type: {MEDIA_TYPE}\r\n"
            f"content-length: {len(body)}\r\n"
            "connection: close\r\n\r\n"
        )
        self.logger.info("refused before it was a request: %s", problem.detail)
        self._stop_waiting()
        self.transport.write(head.encode() + body)
        self.transport.close()
