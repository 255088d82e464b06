"""Every error as ``application/problem+json`` (RFC 9457), never a stack trace."""

from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import Receive, Scope, Send

from app.api.schemas import Problem
from app.camera import LateFrameError
from app.cameras import (
    NoSessionsError,
    TooManyCamerasError,
    UnknownCameraError,
    UnknownEventError,
)
from app.decoding.videos import VideoError
from app.estimation.upload import UploadError
from app.http.routing import RouteTable, request_state
from app.messages import SEARCH_FAILED, expected_and_got, shortened
from app.scheduling.job import BusyError, ClientGoneError
from index.search import SearchUnavailableError

MEDIA_TYPE = "application/problem+json"

_A_CAMERA = "expected a camera that has sent frames of late or is configured"
_AN_EVENT = "expected the id of an event of a person that the camera lists"
_UPLOAD_STATUS = {"undecodable": 400, "too_large": 413, "misfit": 422}


class ProblemError(Exception):
    """An error response, raised where the error is found.

    The detail is one sentence for the client; ``field`` is the parameter or form field at fault;
    the reason is one word for programs, by default the status in words.
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
        # The phrase of 422 differs between releases of Python.
        phrase = "invalid" if status == 422 else HTTPStatus(status).phrase
        self.reason = reason or phrase.lower().replace(" ", "_")
        self.status = status
        self.detail = detail
        self.field = field
        self.headers = dict(headers or {})


def overloaded(detail: str, reason: str, retry_after_s: int | None = 1) -> ProblemError:
    headers = {} if retry_after_s is None else {"Retry-After": str(retry_after_s)}
    return ProblemError(503, detail, headers=headers, reason=reason)


def invalid(field: str, sentence: str) -> ProblemError:
    return ProblemError(422, f"{field}: {sentence}", field=field)


def conflict(error: Exception, reason: str, field: str | None = None) -> ProblemError:
    return ProblemError(409, str(error), reason=reason, field=field)


def busy(error: BusyError) -> ProblemError:
    return overloaded(str(error), error.reason, error.retry_after_s)


def problem_body(error: ProblemError) -> bytes:
    given = {"type": "about:blank", "title": HTTPStatus(error.status).phrase, **vars(error)}
    del given["headers"]
    return Problem.model_validate(given).model_dump_json(exclude_none=True).encode()


class ProblemResponse(Response):
    """The response to an error; notes the reason for the access log."""

    media_type = MEDIA_TYPE

    def __init__(self, error: ProblemError) -> None:
        super().__init__(problem_body(error), error.status, error.headers)
        self._reason = error.reason

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        request_state(scope).rejected_reason = self._reason
        await super().__call__(scope, receive, send)


def register_error_handlers(app: FastAPI, table: RouteTable) -> None:
    def answer(kind: type[Exception], to_problem: Callable[[Any], ProblemError]) -> None:
        @app.exception_handler(kind)
        async def _(request: Request, error: Exception) -> Response:
            return ProblemResponse(to_problem(error))

    answer(ProblemError, lambda error: error)
    answer(UploadError, lambda error: _upload_problem(error, error.field))
    answer(VideoError, lambda error: _upload_problem(error, "video"))
    answer(BusyError, busy)
    answer(LateFrameError, lambda error: conflict(error, "late_frame", "timestamp"))
    answer(TooManyCamerasError, lambda error: conflict(error, "too_many_cameras"))
    answer(NoSessionsError, lambda error: ProblemError(404, str(error), reason="no_sessions"))
    answer(UnknownCameraError, lambda error: ProblemError(404, f"{_A_CAMERA}, got {error.args[0]}"))
    answer(
        UnknownEventError,
        lambda error: ProblemError(404, f"{_AN_EVENT}, got {shortened(error.args[0])}"),
    )
    answer(SearchUnavailableError, lambda _: overloaded(SEARCH_FAILED, "unavailable", 2))
    answer(RequestValidationError, _validation_problem)

    @app.exception_handler(ClientDisconnect)
    @app.exception_handler(ClientGoneError)
    async def _(request: Request, error: Exception) -> Response:
        request_state(request.scope).rejected_reason = "client_gone"
        return Response(status_code=499)  # This is for the log; nobody receives it.

    @app.exception_handler(HTTPException)
    async def _(request: Request, error: HTTPException) -> Response:
        if error.status_code == 404:
            return ProblemResponse(_not_found(request, table))
        if error.status_code == 405:
            return ProblemResponse(_not_allowed(request, table))
        return ProblemResponse(
            ProblemError(error.status_code, str(error.detail), headers=error.headers)
        )


def _upload_problem(error: UploadError | VideoError, field: str) -> ProblemError:
    status = _UPLOAD_STATUS[error.reason]
    return ProblemError(status, str(error), field=field, reason=error.reason)


def _validation_problem(error: RequestValidationError) -> ProblemError:
    first = error.errors()[0]
    # A location begins with the part of the request: query, path or body.
    field = ".".join(str(part) for part in first["loc"][1:]) or None
    return ProblemError(422, f"{field}: {expected_and_got(first)}", field=field)


def _not_found(request: Request, table: RouteTable) -> ProblemError:
    path = request.url.path
    detail = f"expected a path that /docs describes, got {shortened(path)}"
    return ProblemError(404, detail + table.suggestion(path))


def _not_allowed(request: Request, table: RouteTable) -> ProblemError:
    # Starlette's own header lists the methods of one route only, and a path may have several.
    route = table.find(request.url.path)
    methods = route.methods if route else table.methods
    detail = f"expected {' or '.join(methods)}, got {request.method}"
    return ProblemError(405, detail, headers={"Allow": ", ".join(methods)})
