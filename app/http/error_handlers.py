"""Exceptions of the service and of the framework, each answered as a problem."""

from __future__ import annotations

from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from app.estimation.upload import UploadError
from app.http.problems import ProblemError, busy, overloaded, problem_response
from app.http.request_context import note_rejection
from app.http.routing import RouteTable
from app.messages import SEARCH_FAILED, expected_and_got, shortened
from app.scheduling.job import BusyError, ClientGoneError
from app.tracking.session import LateFrameError
from app.video.reader import VideoError
from index.search import UnavailableError

_SEARCHED_AGAIN_IN_S = 2

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
