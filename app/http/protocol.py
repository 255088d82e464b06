"""uvicorn's HTTP/1.1, with bounds on the head of a request and errors as problems."""

from __future__ import annotations

import asyncio
import sys
from http import HTTPStatus

import httptools
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.http.problems import MEDIA_TYPE, ProblemError, problem_body
from app.http.request_context import ENDING


class _HeadTooLargeError(Exception):
    """The head is complete, but larger than allowed."""


class HttpProtocol(HttpToolsProtocol):
    """uvicorn's protocol, with a timeout and a size limit for the head of a request.

    The head is the request line and the headers. A connection on which it is late or too large is
    closed.
    """

    head_timeout_s = 10.0
    max_head_bytes = 16 * 1024

    _head_timer: asyncio.TimerHandle | None = None
    _head_begun = False
    _head_is_new = False
    _head_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take some bytes of a request."""
        self._head_is_new = False
        super().data_received(data)
        if self.transport.is_closing():
            return
        if self._head_begun:
            # The parser reports a header only once it is complete. The bytes that came with the
            # beginning of the head may belong to the previous request.
            self._head_bytes += 0 if self._head_is_new else len(data)
            if self._head_bytes > self.max_head_bytes:
                self._refuse(self._head_too_large())
        elif self._head_timer is None and self._is_idle():
            self._wait_for_head()  # uvicorn no longer waits for the next request.

    def shutdown(self) -> None:
        """Finish the request, which is told; called when the service is being stopped."""
        if not self._is_idle():
            self.scope["state"][ENDING] = True
        super().shutdown()

    def on_message_begin(self) -> None:
        """Begin to read a head."""
        self._wait_for_head()
        self._head_begun = self._head_is_new = True
        self._head_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Answer the request."""
        self._stop_waiting()
        self._head_begun = False
        if len(self.url) + sum(len(k) + len(v) for k, v in self.headers) > self.max_head_bytes:
            raise _HeadTooLargeError
        super().on_headers_complete()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is not a request; called where the parser has raised."""
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
            self._wait_for_head()  # The previous request is still being answered.
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
