"""HTTP/1.1 for uvicorn's setting ``http``: h11 parses requests, the application answers them.

uvicorn's own classes bound neither what comes around the body of a request nor what a client leaves
unread, and the service may face clients without a proxy in between.
"""

import asyncio
import logging
from collections.abc import Callable
from http import HTTPStatus
from typing import Any
from urllib.parse import unquote

import h11
import uvicorn
from starlette.types import Message, Scope
from uvicorn.server import ServerState

from app.http.errors import MEDIA_TYPE, ProblemError, problem_body
from app.http.routing import request_state

log = logging.getLogger("app.http")

# Of the first line and the headers of a request, or of the headers after a body.
MAX_HEAD_BYTES = 16 * 1024
# Of a body that the application has not asked for; then the network is not read.
MAX_BUFFERED_BYTES = 64 * 1024
# Chunks are tiny below this mean size.
MAX_TINY_CHUNKS, MIN_CHUNK_BYTES = 1000, 64
MIN_REPLY_BYTES_PER_S = 4096
_REASONS = {status.value: status.phrase.encode() for status in HTTPStatus}


class HttpProtocol(asyncio.Protocol):
    """A connection: its requests one after the other, each parsed apart from all others.

    It is closed if the head of a request is late or too large, or so are the headers after a body,
    or a body comes in tiny chunks, since all other clients wait while they are parsed; and if the
    client does not read a reply. What comes before the reply to an earlier request is neither
    parsed nor, beyond a segment, read.
    """

    head_timeout_s = 10.0
    unread_timeout_s = 30.0
    half_closed_s = 1.0
    """How long a client that has closed its sending side, or hung up, may wait for its turn."""

    def __init__(
        self,
        config: uvicorn.Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        self.config, self.server, self.app_state = config, server_state, app_state
        self.is_ending = False  # Whether the service is being stopped.
        self._loop = _loop or asyncio.get_running_loop()
        self._exchange = _Exchange(self)
        self._received = b""  # What has not been parsed.
        self._head_bytes = 0
        self._sends_no_more = self._is_paused = False
        self._writable = asyncio.Event()
        self._writable.set()
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self.transport = transport
        self.server.connections.add(self)  # type: ignore[arg-type]
        self._start_timer(self.head_timeout_s, self._close)

    def connection_lost(self, exc: Exception | None) -> None:
        self.server.connections.discard(self)
        self._stop_timer()
        self._writable.set()
        self._exchange.lose_client()

    def data_received(self, data: bytes) -> None:
        """Parse what has come, unless an earlier request has to be answered first."""
        if not self.transport.is_closing():
            self._received = self._received + data if self._received else data
            self._parse()

    def eof_received(self) -> bool:
        """Keep a client that has sent a whole request, which looks like one that has hung up."""
        self._sends_no_more = True
        if self._exchange.is_received:
            self._loop.call_later(self.half_closed_s, self._exchange.lose_patience)
        return self._exchange.is_received

    def pause_writing(self) -> None:
        self._writable.clear()

    def resume_writing(self) -> None:
        self._writable.set()

    def shutdown(self) -> None:
        """Finish the current request, which is told that the service is being stopped."""
        self.is_ending = True
        if self._exchange.is_waited_for:
            request_state(self._exchange.scope).is_ending = True
        else:
            self._close()

    async def write(self, *parts: bytes) -> None:
        """Send bytes, and wait until most have left; end the connection of who reads too little."""
        for part in parts:
            self.transport.write(part)
        while not self._writable.is_set():
            before = self.transport.get_write_buffer_size()
            try:
                async with asyncio.timeout(self.unread_timeout_s):
                    await self._writable.wait()
            except TimeoutError:
                read = before - self.transport.get_write_buffer_size()
                if read < MIN_REPLY_BYTES_PER_S * self.unread_timeout_s:
                    self.transport.abort()
                    return

    def control_reading(self) -> None:
        """Read from the network only if there is room for what comes."""
        waits = self._exchange.is_received and bool(self._received)
        pause = waits or len(self._exchange.body) > MAX_BUFFERED_BYTES
        if pause != self._is_paused and not self.transport.is_closing():
            self._is_paused = pause
            (self.transport.pause_reading if pause else self.transport.resume_reading)()

    def end_exchange(self, *, keep_alive: bool) -> None:
        """Go on after a reply: with the next request, or the rest of a body that nobody wants."""
        self.server.total_requests += 1
        if self.is_ending or not keep_alive:
            self._close()
        elif self._exchange.is_received:
            self._expect_request()
            self._parse()
            if self._sends_no_more and not self._exchange.is_waited_for:
                self._close()
        else:
            self._start_timer(self.head_timeout_s, self._close)
            self.control_reading()

    def _expect_request(self) -> None:
        self._exchange, self._head_bytes = _Exchange(self), 0
        self._start_timer(self.config.timeout_keep_alive, self._close)

    def _parse(self) -> None:
        try:
            while self._received and not self._exchange.is_received:
                if self._exchange.is_begun:
                    self._received = self._exchange.parse(self._received)
                else:
                    self._parse_head()
                if self._exchange.is_received and self._exchange.is_answered:
                    self._expect_request()
        except (ProblemError, h11.RemoteProtocolError) as error:
            self._refuse(error if isinstance(error, ProblemError) else _problem_of(error))
        self.control_reading()

    def _parse_head(self) -> None:
        """Parse no more than a head may have, and possibly the beginning of the body."""
        if not self._head_bytes:
            self._received = self._received.lstrip(b"\r\n")  # Some clients end a body so.
            if not self._received:
                return
            self._start_timer(self.head_timeout_s, self._refuse_late_head)
        part = self._received[: MAX_HEAD_BYTES - self._head_bytes]
        after = self._received[len(part) :]
        self._head_bytes += len(part)
        self._received = self._exchange.parse(part) + after
        if self._exchange.is_begun:
            self._stop_timer()
        elif self._head_bytes >= MAX_HEAD_BYTES:
            raise _head_too_large()

    def _refuse_late_head(self) -> None:
        late = f"expected all headers of the request within {self.head_timeout_s:g} seconds"
        self._refuse(ProblemError(408, late))

    def _refuse(self, problem: ProblemError) -> None:
        """Answer without the application, and close the connection."""
        log.info("refused before it was a request: %s", problem.detail)
        if not self._exchange.is_answering:
            body = problem_body(problem)
            head = (
                f"HTTP/1.1 {problem.status} {HTTPStatus(problem.status).phrase}\r\n"
                f"content-type: {MEDIA_TYPE}\r\n"
                f"content-length: {len(body)}\r\n"
                "connection: close\r\n\r\n"
            )
            self.transport.write(head.encode() + body)
        self._exchange.lose_client()
        self._close()

    def _close(self) -> None:
        """Close the connection, even if the client never reads what has been written."""
        self.transport.close()
        self._start_timer(self.unread_timeout_s, self.transport.abort)

    def _start_timer(self, seconds: float, then: Callable[[], None]) -> None:
        self._stop_timer()
        self._timer = self._loop.call_later(seconds, then)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()


class _Exchange:
    """A request, or the place of the next one, and its reply: from h11 to ASGI and back."""

    scope: Scope

    def __init__(self, connection: HttpProtocol) -> None:
        self._connection = connection
        self._http = h11.Connection(h11.SERVER, MAX_HEAD_BYTES)
        self.body = bytearray()
        self._changed = asyncio.Event()
        self._chunks = self._body_bytes = 0
        self._is_delivered = self._is_lost = self._is_given_up = False
        self.is_begun = self.is_received = self.is_answering = self.is_answered = False

    @property
    def is_waited_for(self) -> bool:
        """Whether a client waits for the reply, or the rest of it."""
        return self.is_begun and not self.is_answered

    def parse(self, data: bytes) -> bytes:
        """Parse a part of the request; return what follows the request."""
        self._http.receive_data(data)
        while True:
            event = self._http.next_event()
            if isinstance(event, h11.Data):
                self._take(event)
            elif isinstance(event, h11.Request):
                self._begin(event)
            elif isinstance(event, h11.EndOfMessage):
                self.is_received = True
                self._changed.set()
                return self._http.trailing_data[0]
            else:
                return b""

    def lose_client(self) -> None:
        self._is_lost = True
        if self.is_waited_for:
            request_state(self.scope).rejected_reason = "client_gone"
        self._changed.set()

    def lose_patience(self) -> None:
        """Take a client that sends no more for gone, unless its reply has begun."""
        self._is_given_up = True
        self._changed.set()

    def _begin(self, request: h11.Request) -> None:
        """Call the application, which asks for the body."""
        if {b"content-length", b"transfer-encoding"} <= {name for name, _ in request.headers}:
            # A proxy in front may believe the other one (RFC 9112, 6.3).
            raise ProblemError(400, "expected Content-Length or Transfer-Encoding, got both")
        self.is_begun = True
        self.scope = self._scope_of(request)
        request_state(self.scope).hang_up = self._connection.transport.abort
        tasks = self._connection.server.tasks
        task = asyncio.get_running_loop().create_task(self._run())
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    def _scope_of(self, request: h11.Request) -> Scope:
        target, get = request.target, self._connection.transport.get_extra_info
        if b"://" in target.partition(b"/")[0] + b"//":  # As to a proxy: http://host/path
            target = b"/" + target.partition(b"://")[2].partition(b"/")[2]
        path, _, query = target.partition(b"?")
        return {
            "type": "http",
            "asgi": {"version": "3.0", "spec_version": "2.3"},
            "http_version": request.http_version.decode(),
            "server": _address(get("sockname")),
            "client": _address(get("peername")),
            "scheme": "http",
            "method": request.method.decode(),
            "root_path": self._connection.config.root_path,
            "path": unquote(path.decode()),
            "raw_path": path,
            "query_string": query,
            "headers": list(request.headers),
            "state": self._connection.app_state.copy(),
        }

    def _take(self, data: h11.Data) -> None:
        """Keep a part of the body; refuse a body that comes in too many tiny chunks."""
        self._chunks += data.chunk_end
        self._body_bytes += len(data.data)
        if self._chunks > MAX_TINY_CHUNKS and self._body_bytes < self._chunks * MIN_CHUNK_BYTES:
            expected = f"chunks of at least {MIN_CHUNK_BYTES} bytes on average"
            raise ProblemError(400, f"expected {expected}, got {self._chunks} smaller ones")
        if not self.is_answered:
            self.body += data.data
            self._changed.set()

    async def _run(self) -> None:
        try:
            await self._connection.config.loaded_app(self.scope, self._receive, self._send)
        except Exception:
            log.exception("the application has not answered")
        finally:
            if not (self.is_answered or self._is_lost):
                self._connection.transport.abort()

    async def _receive(self) -> Message:
        if self._http.they_are_waiting_for_100_continue and not self._is_lost:
            await self._connection.write(
                self._http.send(h11.InformationalResponse(status_code=100, headers=[]))
            )
        while not (self.body or self.is_received > self._is_delivered or self._is_over):
            self._changed.clear()
            await self._changed.wait()
        if self._is_over:
            return {"type": "http.disconnect"}
        body, self.body = bytes(self.body), bytearray()
        self._is_delivered = self.is_received
        self._connection.control_reading()
        return {"type": "http.request", "body": body, "more_body": not self.is_received}

    @property
    def _is_over(self) -> bool:
        """Whether the application need not answer, or has."""
        return self._is_lost or self.is_answered or (self._is_given_up and not self.is_answering)

    async def _send(self, message: Message) -> None:
        if self._is_lost:
            return
        if message["type"] == "http.response.start":
            self.is_answering = True
            headers = [*self._connection.server.default_headers, *message.get("headers", ())]
            if self._connection.is_ending:
                headers.append((b"connection", b"close"))
            reason = _REASONS.get(message["status"], b"")
            start = h11.Response(status_code=message["status"], headers=headers, reason=reason)
            await self._connection.write(self._http.send(start))
            return
        body = b"" if self.scope["method"] == "HEAD" else message.get("body", b"")
        part = self._http.send(h11.Data(data=body))
        if message.get("more_body"):
            await self._connection.write(part)
            return
        await self._connection.write(part, self._http.send(h11.EndOfMessage()))
        self.is_answered = True
        self.body.clear()
        self._changed.set()
        if not self._is_lost:
            self._connection.end_exchange(keep_alive=self._http.our_state is h11.DONE)


def _address(name: Any) -> tuple[str, int] | None:
    """Host and port of a socket's name; None of a socket without them."""
    return (name[0], name[1]) if isinstance(name, tuple) else None


def _head_too_large() -> ProblemError:
    return ProblemError(431, f"expected headers of at most {MAX_HEAD_BYTES} bytes together")


def _problem_of(error: h11.RemoteProtocolError) -> ProblemError:
    if error.error_status_hint == 431:  # The headers after a body, or the line before a chunk.
        return _head_too_large()
    if error.error_status_hint == 501:
        return ProblemError(501, "expected Transfer-Encoding: chunked, or none, got another one")
    return ProblemError(400, "expected a request of HTTP/1.1 with a Host, got something else")
