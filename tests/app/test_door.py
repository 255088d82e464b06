"""What is refused before a byte of the body is read."""

from __future__ import annotations

import os
import threading
from inspect import iscoroutinefunction
from types import ModuleType

import anyio
import pytest
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from starlette.responses import PlainTextResponse
from starlette.types import Message, Receive, Scope, Send

from app.door import Door
from app.pool import OverloadedError, Watch, WorkPool
from app.process import give_way
from app.routes import deepstack, health, index, pose


async def answer(
    door: Door, method: str = "POST", headers: dict[bytes, bytes] | None = None
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

    scope = {"type": "http", "method": method, "headers": list((headers or {}).items())}
    await door(scope, receive, send)
    return sent[0]["status"], dict(sent[0]["headers"]), read


async def reading(scope: Scope, receive: Receive, send: Send) -> None:
    await receive()
    await PlainTextResponse("done")(scope, receive, send)


def door(*, full: bool = False, max_open: int = 4) -> Door:
    return Door(reading, is_full=lambda: full, max_bytes=100, max_open=max_open, timeout_s=1)


def test_a_frame_too_many_is_refused_unread() -> None:
    status, headers, read = anyio.run(answer, door(full=True))
    assert (status, headers[b"retry-after"], read) == (503, b"1", 0)


def test_an_upload_too_many_is_refused_unread() -> None:
    status, headers, read = anyio.run(answer, door(max_open=0))
    assert (status, headers[b"retry-after"], read) == (503, b"1", 0)


def test_a_body_announced_too_large_is_refused_unread() -> None:
    status, _, read = anyio.run(answer, door(), "POST", {b"content-length": b"101"})
    assert (status, read) == (413, 0)


@pytest.mark.parametrize(("method", "full"), [("POST", False), ("GET", True)])
def test_others_pass(method: str, full: bool) -> None:
    status, _, read = anyio.run(answer, door(full=full), method)
    assert (status, read) == (200, 1)


def test_the_pool_says_when_it_is_full() -> None:
    pool = WorkPool(threads=1, queue_length=0, timeout_s=5)
    release = threading.Event()

    async def fill() -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(pool.run, lambda watch: release.wait(5), anyio.sleep_forever)
            while not pool.is_full():
                await anyio.sleep(0.001)

            def work(watch: Watch) -> None:
                raise AssertionError("never started")

            with pytest.raises(OverloadedError):
                await pool.run(work, anyio.sleep_forever)
            release.set()
        assert not pool.is_full()

    anyio.run(fill)


def test_work_gives_way_to_answers() -> None:
    priorities: list[int] = []

    def work() -> None:
        for _ in range(2):  # Twice is no further down than once.
            give_way()
            priorities.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    worker = threading.Thread(target=work)
    worker.start()
    worker.join()
    own = os.getpriority(os.PRIO_PROCESS, os.getpid())
    assert priorities == [min(19, own + 5)] * 2


def functions(dependant: Dependant) -> list[object]:
    """What FastAPI calls for a route."""
    own: list[object] = [dependant.call] if dependant.call else []
    return own + [call for part in dependant.dependencies for call in functions(part)]


@pytest.mark.parametrize("routes", [deepstack, health, index, pose])
def test_dependencies_do_not_hop_between_threads(routes: ModuleType) -> None:
    found = [r for r in routes.router.routes if isinstance(r, APIRoute)]
    assert found
    for call in {call for route in found for call in functions(route.dependant)}:
        assert iscoroutinefunction(call) or iscoroutinefunction(type(call).__call__), call
