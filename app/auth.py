"""API keys: required only if the operator has set any."""

from __future__ import annotations

import hmac
from collections.abc import Iterable
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer

from app.errors import ProblemError
from app.runtime import runtime_of
from app.settings import Settings

_header = APIKeyHeader(
    name="X-API-Key", auto_error=False, description="Required only if the operator has set keys."
)
_bearer = HTTPBearer(auto_error=False, description="The same key as a bearer token.")


def check_key(settings: Settings, given: Iterable[str | None]) -> None:
    """Raise a 401 unless a given key is among the configured ones.

    All pairs are compared, each in constant time, so that the duration reveals nothing.
    """
    if not settings.api_keys:
        return
    matches = [
        hmac.compare_digest(key.get_secret_value().encode(), candidate.encode())
        for candidate in given
        if candidate
        for key in settings.api_keys
    ]
    if not any(matches):
        raise ProblemError(
            401,
            "expected an API key in the header X-API-Key or as a bearer token",
            reason="unauthorised",
            headers={"WWW-Authenticate": "Bearer"},
        )


async def _require_key(
    request: Request,
    header: Annotated[str | None, Security(_header)],
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
) -> None:
    check_key(runtime_of(request).settings, (header, bearer.credentials if bearer else None))


RequireKey = Depends(_require_key)
