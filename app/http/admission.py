"""Admission: limits on the origin, number, size, memory and duration of uploads and their replies.

FastAPI reads a whole body before a route's code runs, so this is plain ASGI middleware: a refused
upload costs neither parsing nor memory.
"""

import asyncio
from collections.abc import Callable, Collection
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.errors import ProblemError, ProblemResponse, busy, overloaded
from app.http.identity import Caller, Identity, identity_of
from app.http.routing import RequestState, request_state
from app.messages import shortened
from app.scheduling.job import BusyError

# An upload slower than this after the grace period is aborted.
UPLOAD_GRACE_S, MIN_BYTES_PER_S = 5.0, 4096
# An upload without data for so long makes room for another one, and so does an unread reply.
STALLED_S, UNREAD_S = 1.0, 10.0


@dataclass(frozen=True)
class UploadLimits:
    """Limits of request bodies of one kind.

    ``max_held_bytes`` is of all together that are received or worked on, and of replies not yet
    read.
    """

    max_bytes: int
    upload_timeout_s: float
    max_held_bytes: int


class _Upload:
    """A body that is being received or worked on, or whose reply is being sent."""

    def __init__(self, caller: Caller, limits: UploadLimits, notes: RequestState) -> None:
        self.caller, self.limits, self._notes = caller, limits, notes
        self._started = asyncio.get_running_loop().time()
        self._waiting_since: float | None = None
        self._timeout: asyncio.Timeout | None = None
        self.received = self.unsent = 0
        self.complete = False

    async def next(self, receive: Receive) -> Message:
        """Return the next message; raise TimeoutError if it does not come in time."""
        grace_s = UPLOAD_GRACE_S + self.received / MIN_BYTES_PER_S
        deadline = self._started + min(self.limits.upload_timeout_s, grace_s)
        self._waiting_since = asyncio.get_running_loop().time()
        try:
            async with asyncio.timeout_at(deadline) as self._timeout:
                message = await receive()
        finally:
            self._waiting_since = self._timeout = None
        self.received += len(message.get("body", b""))
        self.complete = not message.get("more_body", False)
        return message

    async def send(self, message: Message, send: Send) -> None:
        self.unsent = len(message.get("body", b""))
        self._waiting_since = asyncio.get_running_loop().time() + UNREAD_S - STALLED_S
        await send(message)
        self.unsent, self._waiting_since = 0, None

    @property
    def held_bytes(self) -> int:
        return self.received + self.unsent

    def silent_s(self) -> float:
        """Return the seconds for which the client has neither sent nor read what is awaited."""
        if self._waiting_since is None:
            return 0.0
        return asyncio.get_running_loop().time() - self._waiting_since

    def abort(self) -> None:
        """Make :meth:`next` time out now, or end the connection that is not read."""
        self.received = self.unsent = 0
        self._waiting_since = None
        if self._timeout is not None:
            self._timeout.reschedule(asyncio.get_running_loop().time())
        else:
            self._notes.hang_up()


class AdmissionMiddleware:
    """ASGI middleware that refuses uploads which are too large, too slow or too many.

    ``check`` raises BusyError if the request would be refused later. At most ``max_open`` requests
    with a body are received or answered at the same time. Pages of ``origins`` may send uploads,
    besides the service's own; ``*`` means all.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        check: Callable[[Scope, Identity], None],
        limits_of: Callable[[Scope], UploadLimits],
        max_open: int,
        origins: Collection[str] = (),
    ) -> None:
        self.app, self._check, self._limits_of = app, check, limits_of
        self._max_open, self._origins = max_open, origins
        self._uploads: set[_Upload] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] not in ("POST", "PUT", "PATCH"):
            await self.app(scope, receive, send)
            return
        limits = self._limits_of(scope)
        refusal = self._refusal(scope, limits)
        if refusal is not None:
            await ProblemResponse(refusal)(scope, receive, send)
            return
        upload = _Upload(identity_of(scope).caller, limits, request_state(scope))
        self._uploads.add(upload)
        try:
            await self._admit(upload, scope, receive, send)
        finally:
            self._uploads.discard(upload)

    def _refusal(self, scope: Scope, limits: UploadLimits) -> ProblemError | None:
        identity, headers = identity_of(scope), Headers(scope=scope)
        if is_foreign(headers, self._origins):
            return ProblemError(
                403,
                "expected a page of this service or of an origin that it allows, "
                f"got {shortened(headers['origin'])}",
                reason="foreign_origin",
            )
        try:
            self._check(scope, identity)
        except BusyError as error:
            return busy(error)
        if not _has_room(self._uploads, lambda _: 1, self._max_open, identity.caller):
            return _too_many()
        encoding = headers.get("content-encoding", "identity")
        if encoding.lower() != "identity":
            got = f"expected a body without Content-Encoding, got {encoding[:40]}"
            return ProblemError(415, got)
        length = headers.get("content-length", "")
        if length.isdigit() and int(length) > limits.max_bytes:
            return _too_large(limits)
        return None

    def _has_memory(self, upload: _Upload) -> bool:
        alike = [other for other in self._uploads if other.limits == upload.limits]
        most = upload.limits.max_held_bytes
        return _has_room(alike, lambda other: other.held_bytes, most, upload.caller)

    async def _admit(self, upload: _Upload, scope: Scope, receive: Receive, send: Send) -> None:
        async def counting_receive() -> Message:
            if upload.complete:
                return await receive()
            try:
                message = await upload.next(receive)
            except TimeoutError:
                most = f"{upload.limits.upload_timeout_s:g} seconds, without a pause"
                raise ProblemError(
                    408,
                    f"expected the whole upload in {most}",
                    reason="slow_upload",
                    headers={"Connection": "close"},
                ) from None
            if upload.received > upload.limits.max_bytes:
                raise _too_large(upload.limits)
            if not self._has_memory(upload):
                raise _too_many()
            return message

        await self.app(scope, counting_receive, lambda message: upload.send(message, send))


def is_foreign(headers: Headers, allowed: Collection[str]) -> bool:
    """Whether a browser sends a request for a page of an origin that is not allowed to.

    Browsers let every page send a form to every address, even to one that only this machine can
    reach [1]_. Over HTTPS they compare the origins themselves, and say so in ``Sec-Fetch-Site``;
    otherwise the host is compared. Other clients send no ``Origin``.

    References
    ----------
    .. [1] OWASP, "Cross-Site Request Forgery Prevention", fetch metadata and standard headers.
    """
    origin = headers.get("origin")
    if origin is None or origin in allowed or "*" in allowed:
        return False
    if (site := headers.get("sec-fetch-site")) is not None:
        return site not in ("same-origin", "none")
    scheme, _, host = origin.partition("://")
    default_port = {"http": ":80", "https": ":443"}.get(scheme, "")
    own = [headers[name].lower() for name in ("host", "x-forwarded-host") if name in headers]
    return host not in [name.removesuffix(default_port) for name in own]


def _has_room(
    uploads: Collection[_Upload], size: Callable[[_Upload], int], most: int, caller: Caller
) -> bool:
    """Whether one caller's upload may take more room; if need be, a stalled one makes it."""
    own = [upload for upload in uploads if upload.caller == caller]
    # Share of the open uploads, and of their memory, that one caller may have.
    if sum(map(size, own)) >= 0.75 * most:
        return _make_room(own)
    return sum(map(size, uploads)) < most or _make_room(uploads)


def _make_room(uploads: Collection[_Upload]) -> bool:
    """Abort the upload that has been silent for longest, if that is long enough."""
    stalled = max(uploads, key=_Upload.silent_s, default=None)
    if stalled is None or stalled.silent_s() < STALLED_S:
        return False
    stalled.abort()
    return True


def _too_many() -> ProblemError:
    return overloaded("too many uploads at once; try again shortly", "too_many_uploads")


def _too_large(limits: UploadLimits) -> ProblemError:
    most = f"expected a request of at most {limits.max_bytes} bytes"
    return ProblemError(413, most, reason="too_many_bytes")
