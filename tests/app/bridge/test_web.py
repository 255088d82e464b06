"""Webhooks that answer with what is to harm or to hold the bridge."""

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

import pytest

import app.bridge as common
import app.bridge as common_module
from app.bridge import RefusedError, Trouble, UnavailableError, printable, say, web
from app.bridge.outbox import Outbox, deliver
from app.bridge.web import Webhook
from tests.app.bridge.servers import Webhook as FakeWebhook
from tests.app.bridge.servers import event, serving

Capture = pytest.CaptureFixture[str]
Answer = Callable[[socket.socket], None]


def message(number: int = 1) -> dict[str, Any]:
    return {**event("fell", 1e9), "id": f"id-{number}", "camera_id": "yard", "time": "now"}


@contextmanager
def answering(answer: Answer) -> Iterator[Webhook]:
    """A webhook that reads a request and then does as it is told."""

    def serve() -> None:
        with suppress(OSError):
            while True:
                client, _ = server.accept()
                with client:
                    client.recv(2**16)
                    answer(client)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, daemon=True).start()
        yield Webhook(urlsplit(f"http://127.0.0.1:{server.getsockname()[1]}/hook"))


def saying(status: str, body: bytes = b"", head: str = "") -> Answer:
    content = f"HTTP/1.1 {status}\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body
    return lambda client: client.sendall(content)


HOSTILE = "\x1b]0;owned\x07\x1b[2J\r\n12:00:00 all is well\u202e\x9b\ud800" + "x" * 10_000


@pytest.mark.parametrize(
    "answer",
    [
        saying("422 Nope", json.dumps({"detail": HOSTILE}).encode()),
        saying("400 \x1b[2Jno"),
        saying("410 Gone", b"[" * 50_000),
        lambda client: client.sendall(b"\x1b[2J\x07 no HTTP\r\n\r\n"),
        saying("302 Found", head="Location: http://elsewhere/\x1b[2J\r\n"),
    ],
)
def test_what_a_webhook_answers_is_printed_without_control_codes(
    answer: Answer, capsys: Capture
) -> None:
    stopping = threading.Event()
    with answering(answer) as hook:

        def send(message: dict[str, Any]) -> None:
            try:
                hook.send(message)
            finally:
                stopping.set()

        outbox = Outbox("yard", ["webhook"])
        outbox.put(message())
        deliver(outbox, stopping, "webhook", send)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.isprintable()
    assert "webhook" in line and len(line) < 600


@pytest.mark.parametrize("text", ["", "plain", "Zoe\u0308 und Jürgen", "日本"])
def test_what_is_printable_stays(text: str, capsys: Capture) -> None:
    assert printable(text) == text
    say(text)
    assert capsys.readouterr().err.rstrip("\n").endswith(text)


@pytest.mark.parametrize(
    "parts",
    [
        [b"HTTP/1.1 200 OK\r\n"] + [b"X-Wait: 1\r\n"] * 1000,
        [b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n"] + [b"x"] * 1000,
        [b"HTTP/1.1 100 Continue\r\n\r\n"] * 1000,
        [b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"] + [b"1\r\nx\r\n"] * 1000,
    ],
)
def test_an_answer_that_trickles_ends_at_the_deadline(
    parts: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web, "_EVENT_TIMEOUT_S", 0.5)

    def trickle(client: socket.socket) -> None:
        for part in parts:
            client.sendall(part)
            time.sleep(0.05)

    with answering(trickle) as hook:
        began = time.monotonic()
        with pytest.raises(UnavailableError, match=r"took too long|timed out"):
            hook.send(message())
        assert time.monotonic() - began < 3


def test_of_an_endless_answer_only_the_beginning_is_read() -> None:
    sent = [0]

    def endless(client: socket.socket) -> None:
        client.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
        with suppress(OSError):
            while sent[0] < 2**28:
                sent[0] += client.send(b"x" * 2**20)

    with answering(endless) as hook:
        hook.send(message())  # It is accepted.
        time.sleep(0.2)
        assert sent[0] < 2**25


def test_an_event_and_its_password_do_not_follow_a_redirect() -> None:
    other = FakeWebhook()
    with serving(other) as host:
        redirect = saying("307 Go", head=f"Location: http://{host}/hook\r\n")
        said = pytest.raises(UnavailableError, match=f"redirect.* to http://{host}/hook")
        with answering(redirect) as hook, said:
            hook.send(message())
        assert other.seen == []


@pytest.mark.parametrize(
    ("status", "dropped"),
    [(400, True), (405, True), (410, True), (413, True), (415, True), (422, True)]
    + [(code, False) for code in (301, 308, 401, 402, 403, 404, 407, 408, 409, 425, 429, 500, 503)],
)
def test_only_what_would_be_refused_again_is_dropped(status: int, dropped: bool) -> None:
    """A key that expired, a page that moved or too many requests may be mended: events wait."""
    hook = FakeWebhook()
    hook.statuses = [status, status]
    with serving(hook) as host:
        outbox, stopping = Outbox("yard", ["webhook"]), threading.Event()
        outbox.put(message(1))
        outbox.put(message(2))
        real, sent = Webhook(urlsplit(f"http://{host}/")), list[str]()

        def send(message: dict[str, Any]) -> None:
            sent.append(message["id"])
            real.send(message)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(common, "WAITS_S", (0.01,))
            deliver(outbox, stopping, "webhook", send, lambda: len(outbox) or stopping.set())
    taken = [one["id"] for one in hook.got]
    assert taken == ([] if dropped else ["id-1", "id-2"])
    assert sent == (["id-1", "id-2"] if dropped else ["id-1", "id-1", "id-1", "id-2"])
    if dropped:
        with pytest.raises(RefusedError), serving(hook) as host:
            hook.statuses = [status]
            Webhook(urlsplit(f"http://{host}/")).send(message())


def test_a_fault_that_comes_and_goes_is_reported_once_a_minute(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr(common_module.time, "monotonic", lambda: now)
    trouble = Trouble("fine again")
    for _ in range(61):  # The last time a minute after the first.
        trouble.report("too busy")
        trouble.report("too busy")
        trouble.end()
        now += 1.0
    trouble.report("gone")
    trouble.end()
    said = [line.split(" ", 1)[1] for line in capsys.readouterr().err.splitlines()]
    assert said == [*("too busy", "fine again") * 2, "gone", "fine again"]
