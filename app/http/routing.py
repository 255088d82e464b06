"""The paths and methods of the service: for logs, metrics, suggestions and HEAD."""

import re
from collections.abc import Callable, Iterable
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import cast

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


@dataclass(frozen=True)
class KnownRoute:
    """A path as declared (``/index/entries/{entry}``), its pattern, and its methods in order."""

    path: str
    pattern: re.Pattern[str]
    methods: tuple[str, ...]


class RouteTable:
    """The routes of an application that have a path, for middleware that runs before the router."""

    def __init__(self, routes: Iterable[BaseRoute]) -> None:
        self._routes = [_known(route) for route in routes if hasattr(route, "path_regex")]

    def find(self, path: str) -> KnownRoute | None:
        """Return the route that matches a path, None if there is none."""
        return next((route for route in self._routes if route.pattern.match(path)), None)

    def without_slash(self, path: str) -> str:
        """Return a path without a slash at its end, if only that one is known."""
        known = path.endswith("/") and self.find(path) is None and self.find(path[:-1]) is not None
        return path[:-1] if known else path

    @property
    def methods(self) -> tuple[str, ...]:
        """All methods of all routes, in alphabetical order."""
        return tuple(sorted({method for route in self._routes for method in route.methods}))

    def suggestion(self, path: str) -> str:
        """Suggest a similar path as a half-sentence, ``""`` if there is none."""
        return suggestion(path, {route.path: route.path for route in self._routes})


def _known(route: BaseRoute) -> KnownRoute:
    # Mounted folders of files declare no methods.
    methods = set(getattr(route, "methods", None) or {"GET"})
    if "GET" in methods:
        methods.add("HEAD")  # See HeadMiddleware.
    return KnownRoute(route.path, route.path_regex, tuple(sorted(methods)))  # type: ignore[attr-defined]


class HeadMiddleware:
    """ASGI middleware that answers HEAD as GET, without the body."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return

        async def send_without_body(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        await self.app({**scope, "method": "GET"}, receive, send_without_body)
