"""Requests that are no requests, never end or never begin, over a real socket."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest
import uvicorn
from starlette.responses import PlainTextResponse
from uvicorn.server import ServerState

from app.http.protocol import HttpProtocol

pytestmark = pytest.mark.anyio

HEAD = b"GET / HTTP/1.1\r\nHost: localhost\r\n"


class Hasty(HttpProtocol):
    """A protocol with short timeouts."""

    head_timeout_s = 0.5
    max_head_bytes = 1000


@asynccontextmanager
async def connection() -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    config = uvicorn.Config(PlainTextResponse("done"), http=Hasty, log_config=None)
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
