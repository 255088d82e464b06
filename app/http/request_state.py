"""Notes on a request, shared by the layers that it passes."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import cast

from starlette.types import Scope

request_id: ContextVar[str] = ContextVar("request_id", default="")
"""Id of the request for which the current thread or task works; used in log lines."""


@dataclass
class RequestState:
    """Notes on one request, shared by all copies of its scope.

    Parameters
    ----------
    status : int, optional
        Status of the answer, once it has begun.
    headers : dict
        Headers to add to the answer, be it a reply or a problem.
    rejected_reason : str
        Why the request was refused, for the log line and the metrics.
    is_ending : bool
        Whether the service is being stopped.
    """

    status: int | None = None
    headers: dict[str, str] = field(default_factory=dict)
    rejected_reason: str = ""
    is_ending: bool = False


def request_state(scope: Scope) -> RequestState:
    """Return the notes on a request; the first call creates them."""
    notes = scope.setdefault("state", {}).setdefault("request_state", RequestState())
    return cast(RequestState, notes)
