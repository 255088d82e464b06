"""uvicorn's HTTP/1.1, with bounds on all but the body of a request, and errors as problems.

It subclasses a private class of uvicorn, which is why uvicorn is pinned: neither uvicorn nor
httptools bounds what comes around a body, and the service may face clients without a proxy in
between.
"""

import asyncio
import sys
from http import HTTPStatus
from typing import cast

import httptools
from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.http.errors import MEDIA_TYPE, ProblemError, problem_body
from app.http.routing import request_state


class HttpProtocol(HttpToolsProtocol):
    """uvicorn's protocol, with a timeout and a size limit for the head of a request.

    The head is the request line and the headers. A connection is closed if a head is late or too
    large, or so are the headers after a body; and if too many requests wait for the reply to an
    earlier one, or a body comes in tiny chunks, since all other clients wait while they are parsed.
    """

    head_timeout_s = 10.0
    max_head_bytes = 16 * 1024
    max_pipelined = 16
    max_tiny_chunks = 1000
    min_chunk_bytes = 64
    """Mean size from which chunks are not tiny."""

    _head_timer: asyncio.TimerHandle | None = None
    _head_begun = False
    _made_progress = False
    _head_bytes = 0
    _chunks = 0
    _body_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for the first request."""
        super().connection_made(transport)
        self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Count the bytes of a head, or of the headers after a body."""
        self._made_progress = False
        super().data_received(data)
        if self.transport.is_closing():
            return
        # Bytes are counted here because the parser reports a header only once it is complete. Bytes
        # that arrive together with a body or the beginning of a head may belong to what was before,
        # so they are not counted.
        self._head_bytes = 0 if self._made_progress else self._head_bytes + len(data)
        if self._head_bytes > self.max_head_bytes:
            self._refuse(self._head_too_large())
        elif not self._head_begun and self._head_timer is None and self._is_idle():
            self._wait_for_head()  # uvicorn has stopped its own timer.

    def shutdown(self) -> None:
        """Tell the current request that the service is being stopped, and finish it."""
        if not self._is_idle():
            request_state(cast(Scope, self.scope)).is_ending = True
        super().shutdown()

    def on_message_begin(self) -> None:
        """Start the timer and the count for a head."""
        self._wait_for_head()
        self._head_begun = self._made_progress = True
        self._chunks = self._body_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Stop the timer and answer the request."""
        self._stop_waiting()
        self._head_begun = False
        if len(self.url) + sum(len(k) + len(v) for k, v in self.headers) > self.max_head_bytes:
            raise self._head_too_large()
        super().on_headers_complete()
        if len(self.pipeline) > self.max_pipelined:
            most = f"at most {self.max_pipelined} requests before their answers"
            raise ProblemError(400, f"expected {most}, got more")

    def on_body(self, body: bytes) -> None:
        """Count the bytes of a body."""
        self._made_progress = True
        self._body_bytes += len(body)
        super().on_body(body)

    def on_chunk_complete(self) -> None:
        """Refuse a body that comes in too many tiny chunks."""
        self._chunks += 1
        if (
            self._chunks > self.max_tiny_chunks
            and self._body_bytes < self._chunks * self.min_chunk_bytes
        ):
            expected = f"chunks of at least {self.min_chunk_bytes} bytes on average"
            raise ProblemError(400, f"expected {expected}, got {self._chunks} smaller ones")

    def send_400_response(self, msg: str) -> None:
        """Refuse bytes that are no request; called when the parser has raised an error."""
        error = sys.exc_info()[1]
        if error is not None and isinstance(error.__context__, ProblemError):
            self._refuse(error.__context__)  # Raised by a callback above.
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
        if self._is_idle() or not self.cycle.response_started:
            self.transport.write(head.encode() + body)
        self.transport.close()
