"""API keys: required only if the operator has set any."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer

from app.http.identity import position_of_key
from app.http.problems import ProblemError
from app.serving.runtime import runtime_of
from app.settings import Settings

_header = APIKeyHeader(
    name="X-API-Key", auto_error=False, description="Required only if the operator has set keys."
)
_bearer = HTTPBearer(auto_error=False, description="The same key as a bearer token.")


def check_key(settings: Settings, given: Iterable[str | None]) -> int:
    """Return the position of the given key among the configured ones; 0 if none is configured.

    Raises
    ------
    ProblemError
        A 401 if keys are configured and none of them was given.
    """
    if not settings.api_keys:
        return 0
    position = position_of_key(settings, given)
    if position is None:
        raise ProblemError(
            401,
            "expected an API key in the header X-API-Key or as a bearer token",
            reason="unauthorised",
            headers={"WWW-Authenticate": "Bearer"},
        )
    return position


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
