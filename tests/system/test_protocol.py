"""Requests that are no requests, never end or never begin, over a real socket."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest
import uvicorn
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.server import ServerState

from app.http.protocol import HttpProtocol

pytestmark = pytest.mark.anyio

HEAD = b"GET / HTTP/1.1\r\nHost: localhost\r\n"


DONE = PlainTextResponse("done")


async def reading(scope: Scope, receive: Receive, send: Send) -> None:
    """Read the body before the answer."""
    while (await receive()).get("more_body"):
        pass
    await DONE(scope, receive, send)


class Hasty(HttpProtocol):
    """A protocol with short timeouts."""

    head_timeout_s = 0.5
    max_head_bytes = 1000
    max_tiny_chunks = 10


@asynccontextmanager
async def connection(
    app: ASGIApp = DONE,
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    config = uvicorn.Config(app, http=Hasty, log_config=None)
    config.load()
    state = ServerState()
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: Hasty(config, state, {}), "127.0.0.1", 0)
    async with server:
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        async with asyncio.timeout(10):
            yield reader, writer
        writer.close()


async def talk(*sent: bytes) -> bytes:
    """Everything the server sends until it closes the connection."""
    said = bytearray()
    async with connection() as (reader, writer):

        async def listen() -> None:
            with suppress(ConnectionError):  # It may close while it is still being talked to.
                while part := await reader.read(1000):
                    said.extend(part)

        listener = asyncio.create_task(listen())
        for part in sent:
            if listener.done():
                break
            writer.write(part)
            await asyncio.sleep(0.001)
        await listener
    return bytes(said)


def problem(answer: bytes) -> dict[str, Any]:
    """The body of an answer that is one problem."""
    head, body = answer.split(b"\r\n\r\n")
    assert b"content-type: application/problem+json\r\n" in head
    assert b"connection: close" in head
    found: dict[str, Any] = json.loads(body)
    assert head.split()[1] == str(found["status"]).encode()
    return found


async def test_a_request_is_answered() -> None:
    answer = await talk(HEAD[:9], HEAD[9:], b"Connection: close\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 200 OK")
    assert answer.endswith(b"done")


async def test_a_silent_connection_is_closed() -> None:
    assert await talk() == b""
    assert await talk(b"\r\n", b"\r\n") == b""


@pytest.mark.parametrize("begun", [b"G", HEAD, HEAD + b"X-Slow: 1"])
async def test_late_headers_get_a_408(begun: bytes) -> None:
    found = problem(await talk(begun))
    assert found["status"] == 408
    assert "0.5 seconds" in found["detail"]


async def test_late_headers_of_the_next_request_get_a_408() -> None:
    answer = await talk(HEAD + b"\r\n", HEAD)
    first, rest = answer.split(b"done")
    assert first.startswith(b"HTTP/1.1 200 OK")
    assert problem(rest)["status"] == 408


async def test_a_body_does_not_count_towards_the_next_head() -> None:
    post = b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5000\r\n\r\n" + b"x" * 5000
    answer = await talk(post + HEAD, b"Connection: close\r\n\r\n")
    assert answer.count(b"HTTP/1.1 200 OK") == 2


@pytest.mark.parametrize(
    "parts",
    [
        [HEAD + b"X-Long: " + b"x" * 1000 + b"\r\n\r\n"],
        [HEAD + b"X-Long: ", b"x" * 600, b"x" * 600],
        [HEAD, *[f"X-{number}: {'x' * 50}\r\n".encode() for number in range(40)]],
        [b"GET /" + b"x" * 2000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n"],
        [b"GET /", *[b"x" * 300] * 5],
    ],
)
async def test_huge_headers_are_refused(parts: list[bytes]) -> None:
    found = problem(await talk(*parts))
    assert found["status"] == 431
    assert "1000 bytes" in found["detail"]


POST = b"POST / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"


async def test_chunks_of_any_size_are_read_if_few() -> None:
    tiny, large = b"1\r\nx\r\n", b"800\r\n" + b"x" * 2048 + b"\r\n"
    answer = await talk(
        POST, 9 * tiny, 99 * (large + tiny), b"0\r\nX-After: 1\r\n\r\n", HEAD + b"\r\n"
    )
    assert answer.count(b"HTTP/1.1 200 OK") == 2


async def test_many_tiny_chunks_are_refused() -> None:
    async with connection(reading) as (reader, writer):
        writer.write(POST + 11 * b"1\r\nx\r\n")
        found = problem(await reader.read())
    assert found["status"] == 400
    assert "64 bytes on average" in found["detail"]


@pytest.mark.parametrize("after", [b"X-Many: 1\r\n" * 99, b"X-Long: " + b"x" * 999])
async def test_huge_headers_after_a_body_are_refused(after: bytes) -> None:
    async with connection(reading) as (reader, writer):
        writer.write(POST + b"1\r\nx\r\n0\r\n")
        await asyncio.sleep(0.05)
        for part in (after[:500], after[500:]):
            writer.write(part)
            await asyncio.sleep(0.001)
        assert problem(await reader.read())["status"] == 431


async def test_requests_before_their_answers_are_bounded() -> None:
    async with connection(reading) as (reader, writer):
        writer.write(POST + b"0\r\n\r\n" + 99 * (HEAD + b"\r\n"))
        found = problem(await reader.read())
    assert "at most 16 requests" in found["detail"]


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"BREW /pot HTTP/1.1\r\n\r\n", 501),
        (b"hello\r\n\r\n", 501),
        (b"GET / HTTP/9\r\n\r\n", 400),
        (b"GET / HTTP/1.1\r\nno header\r\n\r\n", 400),
        (b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", 400),
        (b"\x16\x03\x01\x02\x00\x01\x00", 501),  # TLS.
    ],
)
async def test_bytes_that_are_no_request_get_a_problem(sent: bytes, status: int) -> None:
    assert problem(await talk(sent))["status"] == status
