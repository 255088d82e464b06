"""Requests that are no requests, never end, never begin or ask for more, over a real socket."""

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
from app.http.routing import request_state

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
    unread_timeout_s = 0.2
    half_closed_s = 0.2


class Patient(HttpProtocol):
    """A protocol that waits for a busy machine, but not for as long as a slow client reads."""

    unread_timeout_s = 1.0


@asynccontextmanager
async def connection(
    app: ASGIApp = DONE, protocol: type[HttpProtocol] = HttpProtocol
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    config = uvicorn.Config(app, http=protocol, log_config=None)
    config.load()
    state = ServerState()
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: protocol(config, state, {}), "127.0.0.1", 0)
    async with server:
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        async with asyncio.timeout(60):
            yield reader, writer
        writer.close()


async def talk(*sent: bytes, protocol: type[HttpProtocol] = HttpProtocol) -> bytes:
    """Everything the server sends until it closes the connection."""
    said = bytearray()
    async with connection(DONE, protocol) as (reader, writer):

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
    assert await talk(protocol=Hasty) == b""
    assert await talk(b"\r\n", b"\r\n", protocol=Hasty) == b""


@pytest.mark.parametrize("begun", [b"G", HEAD, HEAD + b"X-Slow: 1"])
async def test_late_headers_get_a_408(begun: bytes) -> None:
    found = problem(await talk(begun, protocol=Hasty))
    assert found["status"] == 408
    assert "0.5 seconds" in found["detail"]


async def test_a_body_does_not_count_towards_the_next_head() -> None:
    post = b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5000\r\n\r\n" + b"x" * 5000
    answer = await talk(post + HEAD, b"Connection: close\r\n\r\n")
    assert answer.count(b"HTTP/1.1 200 OK") == 2


@pytest.mark.parametrize(
    "parts",
    [
        [HEAD + b"X-Long: " + b"x" * 17_000 + b"\r\n\r\n"],
        [HEAD + b"X-Long: ", b"x" * 9000, b"x" * 9000],
        [HEAD, *[f"X-{number}: {'x' * 990}\r\n".encode() for number in range(20)]],
        [b"GET /" + b"x" * 17_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n"],
        [b"GET /", *[b"x" * 3000] * 6],
        [HEAD + 4000 * b"X: y\r\n" + b"\r\n"],
    ],
)
async def test_huge_headers_are_refused(parts: list[bytes]) -> None:
    found = problem(await talk(*parts))
    assert found["status"] == 431
    assert "16384 bytes" in found["detail"]


POST = b"POST / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"


async def test_chunks_of_any_size_are_read_if_few() -> None:
    tiny, large = b"1\r\nx\r\n", b"800\r\n" + b"x" * 2048 + b"\r\n"
    answer = await talk(
        POST,
        900 * tiny,
        99 * (large + tiny),
        b"0\r\nX-After: 1\r\n\r\n",
        HEAD + b"Connection: close\r\n\r\n",
    )
    assert answer.count(b"HTTP/1.1 200 OK") == 2


async def test_many_tiny_chunks_are_refused() -> None:
    async with connection(reading) as (reader, writer):
        writer.write(POST + 1001 * b"1\r\nx\r\n")
        found = problem(await reader.read())
    assert found["status"] == 400
    assert "64 bytes on average" in found["detail"]


@pytest.mark.parametrize("after", [b"X-Many: 1\r\n" * 9999, b"X-Long: " + b"x" * 17_000])
async def test_huge_headers_after_a_body_are_refused(after: bytes) -> None:
    async with connection(reading) as (reader, writer):
        writer.write(POST + b"1\r\nx\r\n0\r\n")
        await asyncio.sleep(0.05)
        for part in (after[:9000], after[9000:]):
            writer.write(part)
            await asyncio.sleep(0.001)
        assert problem(await reader.read())["status"] == 431


async def repeating(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the method, the path, and the body."""
    body = b""
    while (message := await receive())["type"] == "http.request":
        body += message["body"]
        if not message["more_body"]:
            break
    said = f"<{scope['method']} {scope['path']} ".encode() + body + b">"
    await PlainTextResponse(said)(scope, receive, send)


async def test_requests_before_their_answers_are_answered_in_order() -> None:
    asked = [b"GET /%d HTTP/1.1\r\nHost: x\r\n" % number for number in range(999)]
    async with connection(repeating) as (reader, writer):
        writer.write(b"\r\n".join(asked) + b"Connection: close\r\n\r\n")
        said = await reader.read()
    assert said.count(b"<GET /") == 999
    assert said.index(b"<GET /500 >") < said.index(b"<GET /501 >")


UPGRADES = {
    "h2c": b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMA\r\n",
    "websocket": b"Connection: keep-alive, Upgrade\r\nUpgrade: websocket\r\n",
    "anything": b"Connection: upgrade\r\nUpgrade: anything/7\r\n",
    "without a name": b"Connection: upgrade\r\n",
    "nothing": b"",
}
HIDDEN = b"DELETE /cameras/target HTTP/1.1\r\nHost: x\r\n\r\n"
FRAMINGS = {
    "length": (b"Content-Length: %d\r\n" % len(HIDDEN), HIDDEN),
    "chunks": (b"Transfer-Encoding: chunked\r\n", b"%x\r\n%s\r\n0\r\n\r\n" % (len(HIDDEN), HIDDEN)),
}


@pytest.mark.parametrize("pause", ["", "after the head", "in the body"])
@pytest.mark.parametrize("framing", FRAMINGS)
@pytest.mark.parametrize("upgrade", UPGRADES)
async def test_a_body_is_a_body_whatever_protocol_is_asked_for(
    upgrade: str, framing: str, pause: str
) -> None:
    """A request in it is not carried out; the one behind it is."""
    length, body = FRAMINGS[framing]
    head = b"POST /pose HTTP/1.1\r\nHost: x\r\n" + UPGRADES[upgrade] + length + b"\r\n"
    sent = head + body + b"GET /next HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
    cut = {"": 0, "after the head": len(head), "in the body": len(head) + 9}[pause]
    async with connection(repeating) as (reader, writer):
        writer.write(sent[:cut])
        await asyncio.sleep(0.05 if pause else 0)
        writer.write(sent[cut:])
        said = await reader.read()
    assert said.count(b"HTTP/1.1 200 OK") == 2
    assert b"<POST /pose " + HIDDEN + b">" in said
    assert said.endswith(b"<GET /next >")


@pytest.mark.parametrize(
    "framing",
    [
        b"Content-Length: 4\r\nTransfer-Encoding: chunked\r\n",
        b"Content-Length: 4\r\nContent-Length: 5\r\n",
        b"Transfer-Encoding: chunked, identity\r\n",
        b"Transfer-Encoding : chunked\r\n",
        b"Content-Length: +4\r\n",
        b"Content-Length: 0x4\r\n",
    ],
)
async def test_a_body_whose_end_is_in_doubt_is_refused(framing: bytes) -> None:
    sent = b"POST / HTTP/1.1\r\nHost: x\r\n" + framing + b"\r\n0\r\n\r\n" + HIDDEN
    assert problem(await talk(sent))["status"] in (400, 501)


async def test_all_of_a_body_that_is_not_wanted_is_read() -> None:
    """Most clients send it before they read the reply."""
    size, asked = 2**24, asyncio.Event()

    async def refusing(scope: Scope, receive: Receive, send: Send) -> None:
        await asked.wait()
        await DONE(scope, receive, send)

    async with connection(refusing) as (reader, writer):
        writer.write(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % size)
        writer.write(b"x" * size)
        await asyncio.sleep(0.1)
        asked.set()
        await writer.drain()
        assert (await reader.readuntil(b"done")).startswith(b"HTTP/1.1 200 OK")


async def test_a_body_that_is_not_wanted_is_no_request() -> None:
    """The reply comes before the body, which is dropped; the next request is answered."""
    async with connection() as (reader, writer):
        writer.write(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(HIDDEN))
        assert (await reader.readuntil(b"done")).startswith(b"HTTP/1.1 200 OK")
        writer.write(HIDDEN[:9])
        await asyncio.sleep(0.05)
        writer.write(HIDDEN[9:] + HEAD + b"Connection: close\r\n\r\n")
        assert (await reader.read()).count(b"HTTP/1.1 200 OK") == 1


async def test_a_client_that_waits_for_100_continue_gets_it() -> None:
    head = b"POST /p HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: 2\r\n"
    async with connection(repeating) as (reader, writer):
        writer.write(head + b"Expect: 100-continue\r\n\r\n")
        assert await reader.readuntil(b"\r\n\r\n") == b"HTTP/1.1 100 \r\n\r\n"
        writer.write(b"ab")
        assert (await reader.read()).endswith(b"<POST /p ab>")


async def test_a_client_that_sends_no_more_gets_its_answer() -> None:
    async def slow(scope: Scope, receive: Receive, send: Send) -> None:
        await asyncio.sleep(0.4)  # Longer than it may wait for its turn.
        await repeating(scope, receive, send)

    async with connection(slow, Hasty) as (reader, writer):
        writer.write(b"POST /p HTTP/1.1\r\nHost: x\r\nContent-Length: 2\r\n\r\nab" + HEAD + b"\r\n")
        writer.write_eof()
        said = await reader.read()
    assert said.count(b"HTTP/1.1 200 OK") == 2
    assert b"<POST /p ab>" in said


async def test_an_application_learns_that_a_client_sends_no_more_before_it_answers() -> None:
    """It may have hung up, so a frame should not wait for its turn for long."""
    told = asyncio.Event()

    async def waiting(scope: Scope, receive: Receive, send: Send) -> None:
        while (await receive())["type"] != "http.disconnect":
            pass
        told.set()

    async with connection(waiting, Hasty) as (reader, writer):
        writer.write(HEAD + b"\r\n")
        writer.write_eof()
        await asyncio.sleep(0.1)
        assert not told.is_set()
        await told.wait()
        assert await reader.read() == b""


async def test_a_request_is_finished_when_the_service_is_stopped() -> None:
    told, state = asyncio.Event(), ServerState()

    async def slow(scope: Scope, receive: Receive, send: Send) -> None:
        while not request_state(scope).is_ending:
            await asyncio.sleep(0.01)
        told.set()
        await DONE(scope, receive, send)

    config = uvicorn.Config(slow, http=Hasty, log_config=None)
    config.load()
    server = await asyncio.get_running_loop().create_server(
        lambda: Hasty(config, state, {}), "127.0.0.1", 0
    )
    async with server, asyncio.timeout(60):
        pairs = [await asyncio.open_connection(*server.sockets[0].getsockname()) for _ in "ab"]
        pairs[0][1].write(HEAD + b"\r\n")
        while not state.tasks:
            await asyncio.sleep(0.01)
        for open_connection in tuple(state.connections):
            open_connection.shutdown()
        assert b"connection: close" in await pairs[0][0].read()
        assert await pairs[1][0].read() == b""
        assert told.is_set()


@pytest.mark.parametrize("parts", [1, 400])
async def test_a_reply_that_is_not_read_is_given_up(parts: int) -> None:
    """Its application waits as long as the client may, not longer."""
    ended: list[float] = []

    async def large(scope: Scope, receive: Receive, send: Send) -> None:
        started = asyncio.get_running_loop().time()
        body = b"x" * (2**25 // parts)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        for _ in range(parts):
            await send({"type": "http.response.body", "body": body, "more_body": True})
        ended.append(asyncio.get_running_loop().time() - started)

    async with connection(large, Hasty) as (_, writer):
        writer.write(HEAD + b"\r\n")
        while not ended:
            await asyncio.sleep(0.01)
    assert ended[0] >= 0.2


async def test_a_reply_that_is_read_slowly_is_sent() -> None:
    size = 2**25

    async def large(scope: Scope, receive: Receive, send: Send) -> None:
        await PlainTextResponse(b"x" * size)(scope, receive, send)

    async with connection(large, Patient) as (reader, writer):
        writer.write(HEAD + b"Connection: close\r\n\r\n")
        read, started = 0, asyncio.get_running_loop().time()
        while part := await reader.read(2**20):
            read += len(part)
            await asyncio.sleep(0.02)
        assert asyncio.get_running_loop().time() - started > 2 * Patient.unread_timeout_s
    assert read > size


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"hello\r\n\r\n", 400),
        (b"GET / HTTP/9\r\nHost: x\r\n\r\n", 400),
        (b"GET / HTTP/1.1\r\n\r\n", 400),
        (HEAD + b"no header\r\n\r\n", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: -1\r\n\r\n", 400),
        (b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: gzip\r\n\r\n", 501),
        (b"\x16\x03\x01\x02\x00\x01\x00", 400),  # TLS.
    ],
)
async def test_bytes_that_are_no_request_get_a_problem(sent: bytes, status: int) -> None:
    assert problem(await talk(sent))["status"] == status
