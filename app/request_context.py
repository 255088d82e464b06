"""What is known of the request at hand, wherever in the code: its id, and why it was refused."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

from starlette.types import Scope

NOTES = "pose.notes"
"""Key of a scope: a dictionary that all copies of the scope share."""

request_id: ContextVar[str] = ContextVar("request_id", default="")


def note_rejection(scope: Scope, reason: str) -> None:
    """Say why a request was refused, for the log line and the metrics."""
    notes: dict[str, Any] = scope.get(NOTES, {})
    notes["rejected"] = reason
