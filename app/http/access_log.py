"""An id, a log line and a count in the metrics for every request; never its content."""

from __future__ import annotations

import logging
import re
import time
import uuid
from collections.abc import Callable

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.errors import ProblemError, ProblemResponse
from app.http.metrics import PROBES, Metrics
from app.http.request_state import RequestState, request_id, request_state
from app.http.routing import RouteTable

log = logging.getLogger("app.request")

_HEADER = "X-Request-ID"
_ACCEPTABLE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")


class AccessLogMiddleware:
    """ASGI middleware, the outermost: request ids, log lines, metrics, and unhandled errors.

    Parameters
    ----------
    app : ASGI application
    metrics : Metrics
    table : RouteTable
        Names the route that a request was meant for, even if the request is refused earlier.
    on_refused : callable
        Called with the scope of a refused request and the reason.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        metrics: Metrics,
        table: RouteTable,
        on_refused: Callable[[Scope, str], None] = lambda scope, reason: None,
    ) -> None:
        self.app = app
        self._metrics = metrics
        self._table = table
        self._on_refused = on_refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = time.perf_counter()
        notes = request_state(scope)
        identifier = _given_id(scope) or uuid.uuid4().hex
        token = request_id.set(identifier)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                notes.status = message["status"]
                headers = MutableHeaders(scope=message)
                headers[_HEADER] = identifier
                headers.update(notes.headers)
            await send(message)

        try:
            await self.app(scope, receive, send_with_headers)
            if notes.status is None:  # The client hung up before the answer began.
                notes.status, notes.rejected_reason = 499, "client_gone"
        except Exception:
            log.exception("unhandled error")
            if notes.status is not None:
                raise  # The answer has begun, so the server has to abort it.
            problem = ProblemError(500, "an error of the service; its log says more")
            await ProblemResponse(problem)(scope, receive, send_with_headers)
        finally:
            self._record(scope, notes, time.perf_counter() - started)
            request_id.reset(token)

    def _record(self, scope: Scope, notes: RequestState, seconds: float) -> None:
        known = self._table.find(scope["path"])
        route = known.path if known else "other"
        status = 500 if notes.status is None else notes.status
        self._metrics.observe_request(route, status, seconds, notes.rejected_reason)
        fields = {
            "method": scope["method"],
            "path": scope["path"],
            "status": status,
            "ms": round(seconds * 1000, 2),
            "client": (scope.get("client") or ("",))[0],
        }
        if notes.rejected_reason:
            fields["rejected"] = notes.rejected_reason
            self._on_refused(scope, notes.rejected_reason)
        # Probes and scrapes come every few seconds.
        quiet = route in PROBES and status < 400
        log.log(logging.DEBUG if quiet else logging.INFO, "request", extra={"fields": fields})


def _given_id(scope: Scope) -> str | None:
    value = dict(scope["headers"]).get(_HEADER.lower().encode(), b"")
    return value.decode() if _ACCEPTABLE_ID.fullmatch(value) else None
