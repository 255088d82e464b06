"""What the body of a request is, by its content type."""

from __future__ import annotations

from fastapi import Request

from app.http.problems import ProblemError

_MULTIPART = "multipart/form-data"


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
