"""An id, a log line and a count in the metrics for every request; never its content."""

import json
import logging
import re
import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.errors import ProblemError, ProblemResponse
from app.http.metrics import PROBES, Metrics
from app.http.routing import RequestState, RouteTable, request_id, request_state

log = logging.getLogger("app.request")

_ACCEPTABLE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")


class AccessLogMiddleware:
    """ASGI middleware, the outermost: request ids, log lines, metrics, and unhandled errors.

    ``on_refused`` is called with the scope of a refused request and the reason.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        metrics: Metrics,
        table: RouteTable,
        on_refused: Callable[[Scope, str], None] = lambda scope, reason: None,
    ) -> None:
        self.app, self._metrics, self._table = app, metrics, table
        self._on_refused = on_refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        # Not every client follows a redirect.
        scope["path"] = self._table.without_slash(scope["path"])
        started = time.perf_counter()
        notes = request_state(scope)
        identifier = _given_id(scope) or uuid.uuid4().hex
        token = request_id.set(identifier)

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                notes.status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = identifier
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
    value = dict(scope["headers"]).get(b"x-request-id", b"")
    return value.decode() if _ACCEPTABLE_ID.fullmatch(value) else None


class JsonFormatter(logging.Formatter):
    """Formats a log record as one line of JSON, with the id of its request."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if request_id.get():
            line["request_id"] = request_id.get()
        line |= getattr(record, "fields", {})
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


_STDOUT = "ext://sys.stdout"


def log_config(level: str) -> dict[str, Any]:
    """Return a configuration for :func:`logging.config.dictConfig`: all to standard output."""
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"json": {"()": "app.http.access_log.JsonFormatter"}},
        "handlers": {
            "out": {"class": "logging.StreamHandler", "formatter": "json", "stream": _STDOUT}
        },
        "root": {"handlers": ["out"], "level": "WARNING"},
        "loggers": {
            "app": {"level": level.upper()},
            "uvicorn": {"level": level.upper()},
            "uvicorn.access": {"level": "WARNING"},  # app.request replaces it.
            "python_multipart": {"level": "ERROR"},  # A broken form gets a 400, no line.
        },
    }
