"""Every error as ``application/problem+json`` (RFC 9457), never a stack trace."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import Receive, Scope, Send

from app.cancellation import BusyError, ClientGoneError
from app.messages import expected_and_got, shortened
from app.request_context import note_rejection
from app.route_table import RouteTable
from app.schemas import Problem
from app.tracking.session import LateFrameError
from app.upload import UploadError
from app.video_reader import VideoError
from index.neighbours import UnavailableError

MEDIA_TYPE = "application/problem+json"

_MULTIPART = "multipart/form-data"

SEARCH_FAILED = "the index cannot be searched at present; try again shortly"
_SEARCHED_AGAIN_IN_S = 2


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


def is_multipart(request: Request) -> bool:
    """Whether the content type says that the body is a form with files, in any case."""
    return request.headers.get("content-type", "").lower().startswith(_MULTIPART)


def is_image(request: Request) -> bool:
    """Whether the content type says that the body is an image."""
    return request.headers.get("content-type", "").lower().startswith("image/")


def is_video(request: Request) -> bool:
    """Whether the content type says that the body is a video."""
    return request.headers.get("content-type", "").lower().startswith("video/")


def unsupported_body(request: Request, expected: str = _MULTIPART) -> ProblemError:
    """Make a 415 for any other body."""
    got = request.headers.get("content-type", "")[:100] or "none"
    return ProblemError(415, f"expected a body of type {expected}, got {got}")


def documented(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe error responses of a route for the OpenAPI document."""
    return {
        status: {
            "description": _MEANINGS[status],
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
        for status in statuses
    }


_MEANINGS = {
    400: "An upload is not a decodable image or video.",
    401: "An API key is configured, and the request's is missing or wrong.",
    404: "There is no such thing.",
    408: "The upload took too long.",
    409: "The frame is not later than the last one of its camera.",
    413: "Too many bytes or pixels.",
    415: "The body is neither multipart/form-data nor, where that is taken, an image or a video.",
    422: "A parameter is invalid, or a mask, background or boxes do not fit the frame.",
    503: "Overloaded or unable to search (with Retry-After), or the index is not loaded.",
}

_STATUS_OF_UPLOAD = {"undecodable": 400, "too_large": 413, "misfit": 422}


def register_error_handlers(app: FastAPI, table: RouteTable) -> None:
    """Answer all errors of an application, its own and the framework's, as problems.

    Parameters
    ----------
    app : FastAPI
    table : RouteTable
        Suggests a path where a wrong one is asked for.
    """

    @app.exception_handler(ProblemError)
    async def _(request: Request, error: ProblemError) -> Response:
        return problem_response(error)

    @app.exception_handler(UploadError)
    async def _(request: Request, error: UploadError) -> Response:
        status = _STATUS_OF_UPLOAD[error.reason]
        return problem_response(
            ProblemError(status, str(error), field=error.field, reason=error.reason)
        )

    @app.exception_handler(LateFrameError)
    async def _(request: Request, error: LateFrameError) -> Response:
        return problem_response(
            ProblemError(409, str(error), field="timestamp", reason="late_frame")
        )

    @app.exception_handler(BusyError)
    async def _(request: Request, error: BusyError) -> Response:
        return problem_response(busy(error))

    @app.exception_handler(UnavailableError)
    async def _(request: Request, error: UnavailableError) -> Response:
        # Its own sentence names a server that is none of the caller's business.
        return problem_response(overloaded(SEARCH_FAILED, "unavailable", _SEARCHED_AGAIN_IN_S))

    @app.exception_handler(VideoError)
    async def _(request: Request, error: VideoError) -> Response:
        status = _STATUS_OF_UPLOAD[error.reason]
        return problem_response(
            ProblemError(status, str(error), field="video", reason=error.reason)
        )

    @app.exception_handler(ClientDisconnect)
    @app.exception_handler(ClientGoneError)
    async def _(request: Request, error: Exception) -> Response:
        note_rejection(request.scope, "client_gone")
        return Response(status_code=499)  # For the log; the client is gone.

    @app.exception_handler(RequestValidationError)
    async def _(request: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        # A location starts with the part of the request: query, path, body.
        field = ".".join(str(part) for part in first["loc"][1:]) or None
        return problem_response(
            ProblemError(422, f"{field}: {expected_and_got(first)}", field=field)
        )

    @app.exception_handler(HTTPException)
    async def _(request: Request, error: HTTPException) -> Response:
        if error.status_code == 404:
            return _not_found(request, table)
        if error.status_code == 405:
            return _not_allowed(request, table)
        if error.status_code == 400:  # Raised where a form cannot be parsed, in the parser's words.
            detail = "expected a well-formed multipart/form-data body of at most 1000 parts"
            return problem_response(ProblemError(400, detail, reason="undecodable"))
        return problem_response(
            ProblemError(error.status_code, str(error.detail), headers=error.headers)
        )


def _not_found(request: Request, table: RouteTable) -> Response:
    path = request.url.path
    if len(path) > 2 and path.endswith("/") and table.find(path[:-1]) is not None:
        # Relative, so that it also works behind a proxy that serves us under a path.
        last, query = quote(path[:-1].rsplit("/", 1)[1]), request.url.query
        location = f"../{last}" + (f"?{query}" if query else "")
        # Not every client follows it, so it says what is meant.
        detail = f"expected {path[:-1]}, got {shortened(path)}"
        return problem_response(ProblemError(307, detail, headers={"Location": location}))
    detail = f"expected a path that /docs describes, got {shortened(path)}"
    return problem_response(ProblemError(404, detail + table.suggestion(path)))


def _not_allowed(request: Request, table: RouteTable) -> Response:
    route = table.find(request.url.path)
    methods = route.methods if route else table.methods
    detail = f"expected {' or '.join(methods)}, got {request.method}"
    return problem_response(ProblemError(405, detail, headers={"Allow": ", ".join(methods)}))
