"""Every request has an id, a log line and its count in the metrics; never its content."""

from __future__ import annotations

import logging
import re
import time
import uuid
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.metrics import Metrics
from app.http.problems import ProblemError, problem_response
from app.http.request_context import HEADERS, NOTES, request_id
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
        Tells which route a request was meant for, however far it gets.
    """

    def __init__(self, app: ASGIApp, *, metrics: Metrics, table: RouteTable) -> None:
        self.app = app
        self._metrics = metrics
        self._table = table

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = time.perf_counter()
        notes: dict[str, Any] = {}
        scope[NOTES] = notes
        identifier = _given_id(scope) or uuid.uuid4().hex
        token = request_id.set(identifier)

        async def noting_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                notes["status"] = message["status"]
                headers = MutableHeaders(scope=message)
                headers[_HEADER] = identifier
                headers.update(notes.get(HEADERS, {}))
            await send(message)

        try:
            await self.app(scope, receive, noting_send)
        except Exception:
            log.exception("unhandled error")
            if "status" in notes:
                raise  # The server has to break off the answer that was begun.
            problem = ProblemError(500, "an error of the service; its log says more")
            await problem_response(problem)(scope, receive, noting_send)
        finally:
            self._record(scope, notes, time.perf_counter() - started)
            request_id.reset(token)

    def _record(self, scope: Scope, notes: dict[str, Any], seconds: float) -> None:
        known = self._table.find(scope["path"])
        route = known.path if known else "other"
        status, rejected = notes.get("status", 500), notes.get("rejected")
        self._metrics.requests.labels(route, str(status)).inc()
        self._metrics.seconds.labels(route).observe(seconds)
        if rejected:
            self._metrics.rejected.labels(rejected).inc()
        fields = {
            "method": scope["method"],
            "path": scope["path"],
            "status": status,
            "ms": round(seconds * 1000, 2),
            "client": (scope.get("client") or ("",))[0],
        }
        if rejected:
            fields["rejected"] = rejected
        # Probes and scrapes come every few seconds and say nothing new.
        quiet = route in ("/healthz", "/readyz", "/metrics") and status < 400
        log.log(logging.DEBUG if quiet else logging.INFO, "request", extra={"fields": fields})


def _given_id(scope: Scope) -> str | None:
    value = dict(scope["headers"]).get(_HEADER.lower().encode(), b"")
    return value.decode() if _ACCEPTABLE_ID.fullmatch(value) else None
