"""Who asks: callers share the service alike, each with a key or an address of its own."""

from __future__ import annotations

import hmac
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from starlette.datastructures import Headers
from starlette.types import Scope

from app.settings import Settings
from app.work.line import Sender


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
