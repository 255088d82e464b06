"""Who sends a request: the caller, by key or address, and the camera that a frame names."""

from __future__ import annotations

import hmac
import re
from collections.abc import Iterable, Iterator
from typing import Annotated, NamedTuple

from fastapi import Depends, Header
from starlette.datastructures import Headers
from starlette.types import Scope

from app.scheduling.queue import Sender
from app.settings import Settings


class Caller(NamedTuple):
    """Whoever sends frames, as far as it can be told.

    Parameters
    ----------
    key : int or None
        Position of the key; None where none is configured, or no valid one was given in a header.
    address : str
        Of the client; a proxy on this machine tells it in ``X-Forwarded-For``.
    """

    key: int | None
    address: str


def sender_of(scope: Scope, settings: Settings) -> Sender:
    """Return who sends a request, whatever route it is meant for."""
    key = None
    if settings.api_keys:
        key = position_of_key(settings, keys_in_headers(scope))
    address, port = scope.get("client") or ("", 0)
    # Behind a proxy, the address is the client's and the port is 0.
    return Sender(Caller(key, address), port or None)


def keys_in_headers(scope: Scope) -> Iterator[str]:
    """Yield the keys that a request's headers hold, ``X-API-Key`` and a bearer token."""
    headers = Headers(scope=scope)
    yield headers.get("x-api-key", "")
    scheme, _, token = headers.get("authorization", "").partition(" ")
    yield token if scheme.lower() == "bearer" else ""


def position_of_key(settings: Settings, given: Iterable[str | None]) -> int | None:
    """Return the position of the first configured key that was given, None if none was.

    All pairs are compared, each in constant time, so that the duration reveals nothing.
    """
    matches = [
        position
        for candidate in given
        if candidate
        for position, key in enumerate(settings.api_keys)
        if hmac.compare_digest(key.get_secret_value().encode(), candidate.encode())
    ]
    return matches[0] if matches else None


HEADER = "X-Camera-ID"
# Not "." and "..", which are no names in a path.
CAMERA_PATTERN = "^[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}$"
_HEADER_BYTES = HEADER.lower().encode()
_PATTERN_BYTES = re.compile(CAMERA_PATTERN.encode())
_SESSION_PATH = re.compile("/cameras/([^/]+)/frames")


class CameraStream(NamedTuple):
    """Identifies the frames of a camera: same name, same caller, same route."""

    camera: str
    path: str
    api_key: bytes
    authorization: bytes


def camera_stream(scope: Scope) -> CameraStream | None:
    """Return the stream a request belongs to, None if it names no camera.

    The header names it, or the path of a camera session.
    """
    headers = dict(scope["headers"])
    session = _SESSION_PATH.fullmatch(scope["path"])
    camera = session[1].encode() if session else headers.get(_HEADER_BYTES)
    if camera is None or not _PATTERN_BYTES.match(camera):
        return None
    return CameraStream(
        camera.decode(),
        scope["path"],
        headers.get(b"x-api-key", b""),
        headers.get(b"authorization", b""),
    )


async def _camera_header(
    camera: Annotated[
        str | None,
        Header(
            alias=HEADER,
            pattern=CAMERA_PATTERN,
            description="Name of the camera, for live use: while a frame of it waits, a newer one "
            "takes its place, and the older is answered at once with a 503.",
            examples=["yard-2"],
        ),
    ] = None,
) -> None:
    """Check the name and describe the header; :func:`camera_stream` reads it."""


NamesCamera = Depends(_camera_header)
