"""The identity of a request: its caller, by API key or address, and the camera that it names."""

import hmac
import re
from collections.abc import Iterable, Sequence
from typing import Annotated, NamedTuple, cast

from fastapi import Depends, Header, Request, Security
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer
from pydantic import SecretStr
from starlette.datastructures import Headers
from starlette.types import Scope

from app.configuration import CAMERA_PATTERN
from app.http.errors import ProblemError

CAMERA_HEADER = "X-Camera-ID"

_CAMERA_PATTERN_BYTES = re.compile(CAMERA_PATTERN.encode())
_FRAMES_PATH = re.compile("/cameras/([^/]+)/frames")


class Caller(NamedTuple):
    """The owner of requests: position of the API key among the configured ones, and address."""

    key: int | None
    address: str


class CameraStream(NamedTuple):
    """Identifies the frames of one camera: they share its name, route and API key."""

    camera: str
    path: str
    key: int | None


class Identity(NamedTuple):
    """The source of a request, whatever its route.

    ``stream`` is the camera that it names, in its path or a header. It is authorised if no API key
    is configured, or a header holds one; ``has_key`` is true for a wrong key, too.
    """

    caller: Caller
    stream: CameraStream | None
    is_authorised: bool
    has_key: bool = False


def identity_of(scope: Scope) -> Identity:
    """Return the identity of a request, which is found out once."""
    notes = scope.setdefault("state", {})
    if "identity" not in notes:
        notes["identity"] = identify(scope, scope["app"].state.api_keys)
    return cast(Identity, notes["identity"])


def identify(scope: Scope, api_keys: Sequence[SecretStr]) -> Identity:
    headers = Headers(scope=scope)
    scheme, _, token = headers.get("authorization", "").partition(" ")
    given = [headers.get("x-api-key", ""), token if scheme.lower() == "bearer" else ""]
    key = position_of_key(api_keys, given)
    address, _ = scope.get("client") or ("", 0)
    is_authorised = not api_keys or key is not None
    return Identity(Caller(key, address), _camera_stream(scope, key), is_authorised, any(given))


def position_of_key(api_keys: Sequence[SecretStr], given: Iterable[str | None]) -> int | None:
    """The position of the first configured key among those given, None if there is none.

    All pairs are compared, each in constant time, so that the duration reveals nothing.
    """
    matches = [
        position
        for candidate in given
        if candidate
        for position, key in enumerate(api_keys)
        if hmac.compare_digest(key.get_secret_value().encode(), candidate.encode())
    ]
    return matches[0] if matches else None


def _camera_stream(scope: Scope, key: int | None) -> CameraStream | None:
    headers = dict(scope["headers"])
    session = _FRAMES_PATH.fullmatch(scope["path"])
    camera = session[1].encode() if session else headers.get(CAMERA_HEADER.lower().encode())
    if camera is None or not _CAMERA_PATTERN_BYTES.match(camera):
        return None
    return CameraStream(camera.decode(), scope["path"], key)


def unauthorised(*, has_key: bool) -> ProblemError:
    return ProblemError(
        401,
        "expected an API key of this service, got another one"
        if has_key
        else "expected an API key in the header X-API-Key or as a bearer token, got none",
        reason="unauthorised",
        headers={"WWW-Authenticate": "Bearer"},
    )


_key_header = APIKeyHeader(
    name="X-API-Key", auto_error=False, description="Required only if the operator has set keys."
)
_bearer_token = HTTPBearer(auto_error=False, description="The same key as a bearer token.")


async def _require_key(
    request: Request,
    # Both are declared only for the OpenAPI document; the middleware has read the headers.
    header: Annotated[str | None, Security(_key_header)],
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer_token)],
) -> None:
    identity = identity_of(request.scope)
    if not identity.is_authorised:
        raise unauthorised(has_key=identity.has_key)


RequireKey = Depends(_require_key)
"""Refuses a request without an API key, if the operator has set any."""


async def _camera_header(
    camera: Annotated[
        str | None,
        Header(
            alias=CAMERA_HEADER,
            pattern=CAMERA_PATTERN,
            description="Name of the camera, for live use: while a frame of it waits, a newer one "
            "takes its place, and the older is answered at once with a 503.",
            examples=["yard-2"],
        ),
    ] = None,
) -> None:
    """Validate the header and describe it; the middleware has read it."""


NamesCamera = Depends(_camera_header)
