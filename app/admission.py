"""Admission: how many uploads are received at once, how large they are and how long they take.

FastAPI reads a whole body before any code of a route runs, so this comes before it, as plain ASGI.
A refused upload costs neither parsing nor memory: under overload, the cores are left to the frames
that have been accepted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.errors import ProblemError, overloaded, problem_response
from app.executor import FULL

GRACE_S = 5.0
MIN_BYTES_PER_S = 4096
"""An upload slower than this after the grace period is given up."""

STALLED_S = 1.0
"""An upload that has been silent for this long makes room for another one."""


@dataclass(frozen=True)
class UploadLimits:
    """Limits of one request body.

    Parameters
    ----------
    max_bytes : int
    timeout_s : float
        For receiving it.
    """

    max_bytes: int
    timeout_s: float


class _Upload:
    """One body that is being received.

    Parameters
    ----------
    limits : UploadLimits
    """

    def __init__(self, limits: UploadLimits) -> None:
        self.limits = limits
        self._started = self._last = asyncio.get_running_loop().time()
        self._timeout: asyncio.Timeout | None = None
        self.received = 0
        self.complete = False

    async def next(self, receive: Receive) -> Message:
        """Return the next message; raise TimeoutError if it does not come in time."""
        grace_s = GRACE_S + self.received / MIN_BYTES_PER_S
        deadline = self._started + min(self.limits.timeout_s, grace_s)
        try:
            async with asyncio.timeout_at(deadline) as self._timeout:
                message = await receive()
        finally:
            self._timeout = None
        self._last = asyncio.get_running_loop().time()
        self.received += len(message.get("body", b""))
        self.complete = not message.get("more_body", False)
        return message

    def silent_s(self) -> float:
        """Seconds since the last message, 0 while no further one is awaited."""
        if self._timeout is None:
            return 0.0
        return asyncio.get_running_loop().time() - self._last

    def give_up(self) -> None:
        """Have :meth:`next` time out now."""
        if self._timeout is not None:
            self._last = asyncio.get_running_loop().time()
            self._timeout.reschedule(self._last)


class AdmissionMiddleware:
    """ASGI middleware that refuses uploads which are too large, too slow or too many.

    Parameters
    ----------
    app : ASGI application
    is_full : callable
        Whether the executor would refuse a request of this scope.
    retry_after_s : callable
        Seconds until it probably has room.
    limits : UploadLimits
    limits_of_paths : mapping
        Limits of the paths that have others.
    max_open : int
        Requests with a body that are received or answered at once.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        is_full: Callable[[Scope], bool],
        retry_after_s: Callable[[], int],
        limits: UploadLimits,
        limits_of_paths: Mapping[str, UploadLimits],
        max_open: int,
    ) -> None:
        self.app = app
        self._is_full = is_full
        self._retry_after_s = retry_after_s
        self._limits = limits
        self._limits_of_paths = limits_of_paths
        self._max_open = max_open
        self._uploads: set[_Upload] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http" or scope["method"] not in ("POST", "PUT", "PATCH"):
            await self.app(scope, receive, send)
            return
        limits = self._limits_of_paths.get(scope["path"], self._limits)
        refusal = self._refusal(scope, limits)
        if refusal is not None:
            await problem_response(refusal)(scope, receive, send)
            return
        upload = _Upload(limits)
        self._uploads.add(upload)
        try:
            await self._admit(upload, scope, receive, send)
        finally:
            self._uploads.discard(upload)

    def _refusal(self, scope: Scope, limits: UploadLimits) -> ProblemError | None:
        if self._is_full(scope):
            return overloaded(FULL, "queue_full", self._retry_after_s())
        if len(self._uploads) >= self._max_open and not self._make_room():
            return overloaded("too many uploads at once; try again shortly", "too_many_uploads")
        length = dict(scope["headers"]).get(b"content-length", b"")
        if length.isdigit() and int(length) > limits.max_bytes:
            return _too_large(limits)
        return None

    def _make_room(self) -> bool:
        """Give up the upload that has been silent for longest, if that is long enough."""
        stalled = max(self._uploads, key=_Upload.silent_s, default=None)
        if stalled is None or stalled.silent_s() < STALLED_S:
            return False
        stalled.give_up()
        return True

    async def _admit(self, upload: _Upload, scope: Scope, receive: Receive, send: Send) -> None:
        refusal: ProblemError | None = None
        started = False

        async def counting_receive() -> Message:
            nonlocal refusal
            if upload.complete:
                return await receive()
            try:
                message = await upload.next(receive)
            except TimeoutError:
                refusal = ProblemError(
                    408,
                    f"expected the whole upload in {upload.limits.timeout_s:g} seconds, "
                    "without a pause",
                    reason="slow_upload",
                    headers={"Connection": "close"},
                )
                raise refusal from None
            if upload.received > upload.limits.max_bytes:
                refusal = _too_large(upload.limits)
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


def _too_large(limits: UploadLimits) -> ProblemError:
    return ProblemError(
        413, f"expected a request of at most {limits.max_bytes} bytes", reason="too_many_bytes"
    )
