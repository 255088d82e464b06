"""The door: how many uploads come in at once, how large they are and how long they take.

FastAPI reads a whole body before any code of a route runs, so this stands before it, as
plain ASGI. An upload that is refused costs neither parsing nor memory, so that at many times
the load the service can carry, the cores are left to the frames it has accepted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.errors import ProblemError, overloaded, problem_response
from app.pool import FULL


class Door:
    """ASGI middleware that refuses uploads which are too large, too slow or too many.

    Parameters
    ----------
    app : ASGI application
    is_full : callable
        Whether a frame more would be refused where frames are worked on.
    max_bytes : int
        Of one request body.
    max_open : int
        Requests with a body that are answered or received at once.
    timeout_s : float
        For receiving one body.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        is_full: Callable[[], bool],
        max_bytes: int,
        max_open: int,
        timeout_s: float,
    ) -> None:
        self.app = app
        self._is_full = is_full
        self._max_bytes = max_bytes
        self._max_open = max_open
        self._timeout_s = timeout_s
        self._open = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http" or scope["method"] not in ("POST", "PUT", "PATCH"):
            await self.app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            await problem_response(refusal)(scope, receive, send)
            return
        self._open += 1
        try:
            await self._let_in(scope, receive, send)
        finally:
            self._open -= 1

    def _refusal(self, scope: Scope) -> ProblemError | None:
        if self._is_full():
            return overloaded(FULL, "queue_full")
        if self._open >= self._max_open:
            return overloaded("too many uploads at once; try again shortly", "too_many_uploads")
        length = dict(scope["headers"]).get(b"content-length", b"")
        if length.isdigit() and int(length) > self._max_bytes:
            return self._too_large()
        return None

    def _too_large(self) -> ProblemError:
        return ProblemError(
            413, f"expected a request of at most {self._max_bytes} bytes", reason="too_many_bytes"
        )

    async def _let_in(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal: ProblemError | None = None
        received = 0
        complete = False
        started = False
        deadline = asyncio.get_running_loop().time() + self._timeout_s

        async def counting_receive() -> Message:
            nonlocal refusal, received, complete
            if complete:
                return await receive()
            try:
                async with asyncio.timeout_at(deadline):
                    message = await receive()
            except TimeoutError:
                refusal = ProblemError(
                    408,
                    f"the upload took longer than {self._timeout_s:g} seconds",
                    reason="slow_upload",
                )
                raise refusal from None
            received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if received > self._max_bytes:
                refusal = self._too_large()
                raise refusal
            return message

        async def replacing_send(message: Message) -> None:
            # The framework turns what is raised above into a 400 of its own.
            nonlocal started
            if refusal is None:
                await send(message)
            elif not started:
                started = True
                await problem_response(refusal)(scope, receive, send)

        await self.app(scope, counting_receive, replacing_send)
