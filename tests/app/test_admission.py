"""What is refused before a byte of the body is read."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from inspect import isasyncgenfunction, iscoroutinefunction
from types import ModuleType
from typing import Any

import anyio
import pytest
from fastapi.routing import APIRoute
from starlette.responses import PlainTextResponse
from starlette.types import Message, Receive, Scope, Send

from app.http.admission import AdmissionMiddleware, UploadLimits
from app.http.problems import ProblemError
from app.routes import cameras, deepstack, health, index, pose, sequence
from app.work.line import OverloadedError


async def answer(
    middleware: AdmissionMiddleware,
    method: str = "POST",
    headers: dict[bytes, bytes] | None = None,
    path: str = "/pose",
    caller: str | None = None,
) -> tuple[int, dict[bytes, bytes], int]:
    """Status and headers of the answer, and how many messages of the body were read."""
    sent: list[Message] = []
    read = 0

    async def receive() -> Message:
        nonlocal read
        read += 1
        return {"type": "http.request", "body": b"x", "more_body": False}

    async def send(message: Message) -> None:
        sent.append(message)

    fields = list((headers or {}).items())
    scope = {"type": "http", "method": method, "path": path, "headers": fields, "caller": caller}
    await middleware(scope, receive, send)
    return sent[0]["status"], dict(sent[0]["headers"]), read


async def reading(scope: Scope, receive: Receive, send: Send) -> None:
    response = PlainTextResponse("done")
    try:
        await receive()
    except ProblemError:  # As the framework does where a body cannot be read.
        response = PlainTextResponse("cannot be read", 400)
    await response(scope, receive, send)


def refuse(scope: Scope) -> None:
    raise OverloadedError("the service is working to capacity", retry_after_s=7)


def admission(
    *, full: bool = False, max_open: int = 4, timeout_s: float = 1
) -> AdmissionMiddleware:
    return AdmissionMiddleware(
        reading,
        check=refuse if full else lambda scope: None,
        caller_of=lambda scope: scope.get("caller"),
        limits=UploadLimits(100, timeout_s),
        limits_of_paths={"/sequence": UploadLimits(1000, timeout_s)},
        max_open=max_open,
    )


def test_a_frame_too_many_is_refused_unread() -> None:
    status, headers, read = anyio.run(answer, admission(full=True))
    assert (status, headers[b"retry-after"], read) == (503, b"7", 0)


def test_an_upload_too_many_is_refused_unread() -> None:
    status, headers, read = anyio.run(answer, admission(max_open=0))
    assert (status, headers[b"retry-after"], read) == (503, b"1", 0)


def test_a_body_announced_too_large_is_refused_unread() -> None:
    status, _, read = anyio.run(answer, admission(), "POST", {b"content-length": b"101"})
    assert (status, read) == (413, 0)


def test_videos_have_limits_of_their_own() -> None:
    headers = {b"content-length": b"101"}
    status, _, read = anyio.run(answer, admission(), "POST", headers, "/sequence")
    assert (status, read) == (200, 1)
    headers = {b"content-length": b"1001"}
    status, _, read = anyio.run(answer, admission(), "POST", headers, "/sequence")
    assert (status, read) == (413, 0)


def test_one_caller_cannot_take_all_places() -> None:
    stalled = StalledUploads(max_open=4)

    async def ask() -> None:
        async with anyio.create_task_group() as tasks:
            for _ in range(4):
                tasks.start_soon(stalled.stall)
            await anyio.wait_all_tasks_blocked()
            assert stalled.statuses == [503]
            assert (await answer(stalled.admission, caller="another"))[0] == 200
            tasks.cancel_scope.cancel()

    anyio.run(ask)


@pytest.mark.parametrize(("method", "full"), [("POST", False), ("GET", True)])
def test_others_pass(method: str, full: bool) -> None:
    status, _, read = anyio.run(answer, admission(full=full), method)
    assert (status, read) == (200, 1)


def functions(dependant: Any) -> list[object]:
    """What FastAPI calls for a route."""
    own: list[object] = [dependant.call] if dependant.call else []
    return own + [call for part in dependant.dependencies for call in functions(part)]


@pytest.mark.parametrize("routes", [cameras, deepstack, health, index, pose, sequence])
def test_dependencies_do_not_hop_between_threads(routes: ModuleType) -> None:
    found = [r for r in routes.router.routes if isinstance(r, APIRoute)]
    assert found
    for call in {call for route in found for call in functions(route.dependant)}:
        known = (call, type(call).__call__)
        assert any(iscoroutinefunction(c) or isasyncgenfunction(c) for c in known), call


class StalledUploads:
    """Requests whose bodies never come, where there is room for some."""

    def __init__(self, max_open: int = 2) -> None:
        self.admission = admission(max_open=max_open, timeout_s=30)
        self.statuses: list[int] = []

    async def stall(self) -> None:
        async def send(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.statuses.append(message["status"])

        scope = {"type": "http", "method": "POST", "path": "/pose", "headers": []}
        await self.admission(scope, anyio.sleep_forever, send)


def test_stalled_uploads_give_their_places_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    stalled = StalledUploads()

    async def ask() -> None:
        async with anyio.create_task_group() as tasks:
            for _ in range(2):
                tasks.start_soon(stalled.stall)
            await anyio.wait_all_tasks_blocked()
            monkeypatch.setattr("app.http.admission.STALLED_S", 60.0)
            assert (await answer(stalled.admission))[0] == 503  # They have only just begun.
            monkeypatch.setattr("app.http.admission.STALLED_S", 0.0)
            for _ in range(3):
                assert (await answer(stalled.admission))[0] == 200
                await anyio.wait_all_tasks_blocked()
            assert stalled.statuses == [408] * len(stalled.statuses) != []
            tasks.cancel_scope.cancel()

    anyio.run(ask)


def test_a_stalled_upload_is_given_up_long_before_a_slow_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("app.http.admission.GRACE_S", 0.05)
    stalled = StalledUploads()
    with_deadline = anyio.run(_within, stalled.stall)
    assert with_deadline
    assert stalled.statuses == [408]


async def _within(job: Callable[[], Awaitable[None]]) -> bool:
    with anyio.move_on_after(5) as scope:
        await job()
    return not scope.cancelled_caught
