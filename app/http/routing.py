"""The paths and methods of the service: for logs, metrics, suggestions and HEAD."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.messages import suggestion


@dataclass(frozen=True)
class KnownRoute:
    """A path of the service.

    Parameters
    ----------
    path : str
        As declared: ``/index/entries/{entry}``.
    pattern : compiled regular expression
        Matches the paths of requests.
    methods : tuple of str
        In alphabetical order.
    """

    path: str
    pattern: re.Pattern[str]
    methods: tuple[str, ...]


class RouteTable:
    """The routes of an application, for middleware that runs before the router.

    Parameters
    ----------
    routes : iterable of BaseRoute
        Starlette's and FastAPI's; routes without a path are ignored.
    """

    def __init__(self, routes: Iterable[BaseRoute]) -> None:
        self._routes = [_known(route) for route in routes if hasattr(route, "path_regex")]

    def find(self, path: str) -> KnownRoute | None:
        """Return the route that matches a path, None if there is none."""
        return next((route for route in self._routes if route.pattern.match(path)), None)

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
