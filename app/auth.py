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


def check_key(settings: Settings, given: Iterable[str | None]) -> int:
    """Return the position of the given key among the configured ones; 0 if none is configured.

    All pairs are compared, each in constant time, so that the duration reveals nothing.

    Raises
    ------
    ProblemError
        A 401 if keys are configured and none of them was given.
    """
    if not settings.api_keys:
        return 0
    matches = [
        position
        for candidate in given
        if candidate
        for position, key in enumerate(settings.api_keys)
        if hmac.compare_digest(key.get_secret_value().encode(), candidate.encode())
    ]
    if not matches:
        raise ProblemError(
            401,
            "expected an API key in the header X-API-Key or as a bearer token",
            reason="unauthorised",
            headers={"WWW-Authenticate": "Bearer"},
        )
    return matches[0]


async def _require_key(
    request: Request,
    header: Annotated[str | None, Security(_header)],
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
) -> int:
    given = (header, bearer.credentials if bearer else None)
    return check_key(runtime_of(request).settings, given)


RequireKey = Depends(_require_key)

Caller = Annotated[int, RequireKey]
"""The caller, by the position of their key; all are the same where no keys are configured."""
