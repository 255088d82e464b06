"""Every error as ``application/problem+json`` (RFC 9457), never a stack trace."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus

from fastapi.responses import Response
from starlette.types import Receive, Scope, Send

from app.api.schemas import Problem
from app.http.request_context import note_rejection
from app.scheduling.job import BusyError

MEDIA_TYPE = "application/problem+json"


class ProblemError(Exception):
    """An answer other than success, raised where it is found.

    Parameters
    ----------
    status : int
        HTTP status.
    detail : str
        One sentence for the caller.
    field : str, optional
        The parameter or form field it is about.
    headers : mapping, optional
    reason : str, optional
        For programs; by default the status in words.
    """

    def __init__(
        self,
        status: int,
        detail: str,
        *,
        field: str | None = None,
        headers: Mapping[str, str] | None = None,
        reason: str | None = None,
    ) -> None:
        super().__init__(detail)
        self.reason = reason or _default_reason(status)
        self.status = status
        self.detail = detail
        self.field = field
        self.headers = dict(headers or {})


def _default_reason(status: int) -> str:
    # The phrase of 422 depends on the release of Python.
    return "invalid" if status == 422 else HTTPStatus(status).phrase.lower().replace(" ", "_")


def problem_body(error: ProblemError) -> bytes:
    """Write an error as JSON."""
    problem = Problem(
        type="about:blank",
        title=HTTPStatus(error.status).phrase,
        status=error.status,
        detail=error.detail,
        reason=error.reason,
        field=error.field,
    )
    return problem.model_dump_json(exclude_none=True).encode()


def problem_response(error: ProblemError) -> Response:
    """Turn an error into its answer."""
    return _ProblemResponse(error)


class _ProblemResponse(Response):
    """Notes why the request was refused, from wherever it is sent."""

    media_type = MEDIA_TYPE

    def __init__(self, error: ProblemError) -> None:
        super().__init__(problem_body(error), error.status, error.headers)
        self._reason = error.reason

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        note_rejection(scope, self._reason)
        await super().__call__(scope, receive, send)


def overloaded(detail: str, reason: str, retry_after_s: int | None = 1) -> ProblemError:
    """Make a 503 that says when to come back, if that is of use."""
    headers = {} if retry_after_s is None else {"Retry-After": str(retry_after_s)}
    return ProblemError(503, detail, headers=headers, reason=reason)


def busy(error: BusyError) -> ProblemError:
    """Make the 503 for work that the service has no room for."""
    return overloaded(str(error), error.reason, error.retry_after_s)
