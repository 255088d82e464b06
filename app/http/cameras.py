"""Live cameras: which frames come from the same camera."""

from __future__ import annotations

import re
from typing import Annotated, NamedTuple

from fastapi import Depends, Header
from starlette.types import Scope

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
