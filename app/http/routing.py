"""The paths and methods of the service: for logs, metrics, suggestions and HEAD."""

import re
from collections.abc import Callable, Iterable
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import NamedTuple, cast

from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.messages import suggestion

request_id: ContextVar[str] = ContextVar("request_id", default="")
"""Id of the request for which the current thread or task works; used in log lines."""


@dataclass
class RequestState:
    """Notes on one request, shared by all copies of its scope.

    ``status`` is that of the reply, once it has begun; ``headers`` are added to it, also if it is a
    problem. ``rejected_reason`` is for the log and the metrics; ``is_ending`` says whether the
    service is being stopped; ``hang_up`` ends the connection, with an incomplete reply if need be.
    """

    status: int | None = None
    headers: dict[str, str] = field(default_factory=dict)
    rejected_reason: str = ""
    is_ending: bool = False
    hang_up: Callable[[], None] = lambda: None


def request_state(scope: Scope) -> RequestState:
    """Return the notes on a request; the first call creates them."""
    notes = scope.setdefault("state", {}).setdefault("request_state", RequestState())
    return cast(RequestState, notes)


class KnownRoute(NamedTuple):
    """A path as declared (``/index/entries/{entry}``), its pattern, and its methods in order."""

    path: str
    pattern: re.Pattern[str]
    methods: tuple[str, ...]


class RouteTable:
    """The routes of an application that have a path, for middleware that runs before the router."""

    def __init__(self, routes: Iterable[BaseRoute]) -> None:
        self._routes = [_known(route) for route in routes if hasattr(route, "path_regex")]

    def find(self, path: str) -> KnownRoute | None:
        return next((route for route in self._routes if route.pattern.match(path)), None)

    def without_slash(self, path: str) -> str:
        """Return a path without a slash at its end, if only that one is known."""
        known = path.endswith("/") and self.find(path) is None and self.find(path[:-1]) is not None
        return path[:-1] if known else path

    @property
    def methods(self) -> tuple[str, ...]:
        return tuple(sorted({method for route in self._routes for method in route.methods}))

    def suggestion(self, path: str) -> str:
        """Suggest a similar path as a half-sentence, ``""`` if there is none."""
        return suggestion(path, {route.path: route.path for route in self._routes})


def _known(route: BaseRoute) -> KnownRoute:
    # Mounted folders of files declare no methods.
    methods = set(getattr(route, "methods", None) or {"GET"})
    if "GET" in methods:
        methods.add("HEAD")  # See answering_head.
    return KnownRoute(route.path, route.path_regex, tuple(sorted(methods)))  # type: ignore[attr-defined]


def answering_head(app: ASGIApp) -> ASGIApp:
    """ASGI middleware that answers HEAD as GET, without the body."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        is_head = scope["type"] == "http" and scope["method"] == "HEAD"

        async def send_without_body(message: Message) -> None:
            await send({**message, "body": b""} if "body" in message else message)

        seen = {**scope, "method": "GET"} if is_head else scope
        await app(seen, receive, send_without_body if is_head else send)

    return answer
