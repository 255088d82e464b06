"""What is known of the request at hand, wherever in the code: its id, and why it was refused."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

from starlette.types import Scope

NOTES = "pose.notes"
"""Key of a scope: a dictionary that all copies of the scope share."""

request_id: ContextVar[str] = ContextVar("request_id", default="")


ENDING = "pose.ending"
"""Key of a request's state: whether the service is being stopped."""


def is_ending(scope: Scope) -> bool:
    """Whether the service is being stopped while it answers this request."""
    return bool(scope.get("state", {}).get(ENDING))


HEADERS = "headers"
"""Key of the notes: headers that the answer shall have, whatever it will be."""


def note_header(scope: Scope, name: str, value: str) -> None:
    """Give the answer a header, whatever it will be: a reply or a problem."""
    notes: dict[str, Any] = scope.get(NOTES, {})
    notes.setdefault(HEADERS, {})[name] = value


def note_rejection(scope: Scope, reason: str) -> None:
    """Say why a request was refused, for the log line and the metrics."""
    notes: dict[str, Any] = scope.get(NOTES, {})
    notes["rejected"] = reason
