"""Requests that are refused before a byte of the body is read."""

from typing import Any

import anyio
import pytest
from starlette.responses import PlainTextResponse, Response
from starlette.types import Message, Receive, Scope, Send

from app.http.admission import AdmissionMiddleware, UploadLimits
from app.http.errors import ProblemError, ProblemResponse
from app.http.identity import Caller, Identity
from app.http.routing import request_state
from app.scheduling.queue import OverloadedError

pytestmark = pytest.mark.anyio


def scope_of(
    method: str = "POST", path: str = "/pose", headers: Any = (), caller: str = ""
) -> Scope:
    identity = Identity(Caller(None, caller), None, True)
    return {"type": "http", "method": method, "path": path, "headers": headers,
            "state": {"identity": identity}}  # fmt: skip


async def answer(
    middleware: AdmissionMiddleware,
    method: str = "POST",
    headers: dict[bytes, bytes] | None = None,
    path: str = "/pose",
    caller: str = "",
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
    await middleware(scope_of(method, path, fields, caller), receive, send)
    return sent[0]["status"], dict(sent[0]["headers"]), read


async def reading(scope: Scope, receive: Receive, send: Send) -> None:
    response: Response = PlainTextResponse("done")
    try:
        while (await receive()).get("more_body"):
            pass
    except ProblemError as error:
        response = ProblemResponse(error)
    await response(scope, receive, send)


def refuse(scope: Scope, identity: Identity) -> None:
    raise OverloadedError("the service is working to capacity", retry_after_s=7)


def admission(
    *, full: bool = False, max_open: int = 4, timeout_s: float = 1
) -> AdmissionMiddleware:
    return AdmissionMiddleware(
        reading,
        check=refuse if full else lambda scope, identity: None,
        limits_of=lambda scope: UploadLimits(
            {"/pose": 100, "/sequence": 1000}[scope["path"]], timeout_s, 300
        ),
        max_open=max_open,
    )


def length(size: int) -> dict[bytes, bytes]:
    return {b"content-length": str(size).encode()}


@pytest.mark.parametrize(
    ("options", "asked", "expected"),
    [
        ({"full": True}, ("POST",), (503, b"7", 0)),
        ({"max_open": 0}, ("POST",), (503, b"1", 0)),
        ({}, ("POST", length(101)), (413, None, 0)),
        # Videos have limits of their own.
        ({}, ("POST", length(1001), "/sequence"), (413, None, 0)),
        ({}, ("POST", length(101), "/sequence"), (200, None, 1)),
        ({}, ("POST",), (200, None, 1)),
        ({"full": True}, ("GET",), (200, None, 1)),
    ],
)
async def test_excess_is_refused_unread(
    options: dict[str, Any], asked: tuple[Any, ...], expected: tuple[int, bytes | None, int]
) -> None:
    status, headers, read = await answer(admission(**options), *asked)
    assert (status, headers.get(b"retry-after"), read) == expected


async def test_one_caller_cannot_take_all_places() -> None:
    stalled = StalledUploads(max_open=4)
    async with anyio.create_task_group() as tasks:
        for _ in range(4):
            tasks.start_soon(stalled.stall)
        await anyio.wait_all_tasks_blocked()
        assert stalled.statuses == [503]
        assert (await answer(stalled.admission, caller="another"))[0] == 200
        tasks.cancel_scope.cancel()


class StalledUploads:
    """Requests whose bodies never arrive as a whole, where there is room for some."""

    def __init__(self, max_open: int = 2) -> None:
        self.admission = admission(max_open=max_open, timeout_s=30)
        self.statuses: list[int] = []

    async def stall(self, begun: bytes = b"", caller: str = "") -> None:
        parts = [{"type": "http.request", "body": begun, "more_body": True}] if begun else []

        async def receive() -> Message:
            return parts.pop() if parts else await anyio.sleep_forever()

        async def send(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.statuses.append(message["status"])

        await self.admission(scope_of(caller=caller), receive, send)


@pytest.mark.parametrize("begun", [(b"", b""), (b"x" * 100, b"x" * 100, b"x" * 24)])
async def test_stalled_uploads_make_room_for_others(
    begun: tuple[bytes, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """While they have only just begun, one more is refused; then it is answered."""
    stalled = StalledUploads(2 if b"" in begun else 9)
    async with anyio.create_task_group() as tasks:
        for part in begun:
            tasks.start_soon(stalled.stall, part)
        await anyio.wait_all_tasks_blocked()
        monkeypatch.setattr("app.http.admission.STALLED_S", 60.0)
        assert (await answer(stalled.admission))[0] == 503
        monkeypatch.setattr("app.http.admission.STALLED_S", 0.0)
        for _ in range(3):
            assert (await answer(stalled.admission))[0] == 200
            await anyio.wait_all_tasks_blocked()
        assert stalled.statuses == [408] * len(stalled.statuses) != []
        tasks.cancel_scope.cancel()


async def test_uploads_have_a_limit_of_memory_in_common() -> None:
    """Of 300 bytes together, 225 for one caller."""
    stalled = StalledUploads(9)
    async with anyio.create_task_group() as tasks:
        for count, caller in ((2, "one"), (1, "two"), (1, "one")):
            for _ in range(count):
                tasks.start_soon(stalled.stall, b"x" * 90, caller)
            await anyio.wait_all_tasks_blocked()
        assert stalled.statuses == [503]
        tasks.start_soon(stalled.stall, b"x" * 90, "three")
        await anyio.wait_all_tasks_blocked()
        assert stalled.statuses == [503, 503]
        tasks.cancel_scope.cancel()


async def test_replies_that_are_not_read_count_and_make_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 300 bytes together, 225 for one caller: after two of 100 bytes, none of 90 has room."""
    hung_up: list[str] = []
    monkeypatch.setattr("app.http.admission.UNREAD_S", 1.0)

    async def replying(scope: Scope, receive: Receive, send: Send) -> None:
        await receive()
        await PlainTextResponse(b"x" * 100)(scope, receive, send)

    unread = StalledUploads(9)
    unread.admission.app = replying

    async def ask(name: str) -> None:
        scope = scope_of(caller="one")
        gone = anyio.Event()
        request_state(scope).hang_up = lambda: (hung_up.append(name), gone.set())

        async def receive() -> Message:
            return {"type": "http.request", "body": b"x" * 20, "more_body": False}

        async def send(message: Message) -> None:
            if message["type"] == "http.response.body":
                await gone.wait()

        await unread.admission(scope, receive, send)

    async with anyio.create_task_group() as tasks:
        for name in ("first", "second"):
            tasks.start_soon(ask, name)
            await anyio.wait_all_tasks_blocked()
        unread.admission.app = reading
        with anyio.move_on_after(5):
            await unread.stall(b"x" * 30, caller="one")
        assert (unread.statuses, hung_up) == ([503], [])
        monkeypatch.setattr("app.http.admission.STALLED_S", 0.0)
        with anyio.move_on_after(0.1):
            await unread.stall(b"x" * 30, caller="one")
        assert (unread.statuses, hung_up) == ([503], ["first"])
        tasks.cancel_scope.cancel()


async def test_a_stalled_upload_is_aborted_after_the_grace_period(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("app.http.admission.UPLOAD_GRACE_S", 0.05)
    stalled = StalledUploads()
    with anyio.fail_after(5):
        await stalled.stall()
    assert stalled.statuses == [408]
