"""The measuring client over a real socket: answers whole, and connections kept or opened anew."""

import itertools
import socket
import socketserver
import threading
from collections.abc import Iterator

import pytest

from scripts.load.client import Call, Client, Request, closed_loop


class Server(socketserver.ThreadingTCPServer):
    """Answers with the body it was sent, in small pieces, and counts its connections."""

    daemon_threads = True
    connections = 0
    breaks_off = False
    closes: bytes | None = None
    """The value of the header ``Connection``; None for a server that closes without a word."""


class Handler(socketserver.StreamRequestHandler):
    server: Server

    def handle(self) -> None:
        self.server.connections += 1
        while line := self.rfile.readline():
            length = 0
            while line.strip():
                name, _, value = line.partition(b":")
                if name.lower() == b"content-length":
                    length = int(value)
                line = self.rfile.readline()
            self._answer(self.rfile.read(length))
            if self.server.closes != b"keep-alive":
                return

    def _answer(self, body: bytes) -> None:
        kept = b"Connection: %s\r\n" % self.server.closes if self.server.closes else b""
        head = b"HTTP/1.1 201 Created\r\nContent-Length: %d\r\n%s\r\n" % (len(body), kept)
        if self.server.breaks_off:
            body = body[:-1]
        for start in range(0, len(head + body), 7):
            self.wfile.write((head + body)[start : start + 7])
            self.wfile.flush()


@pytest.fixture
def server() -> Iterator[Server]:
    with Server(("127.0.0.1", 0), Handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield running
        running.shutdown()


def address_of(server: Server) -> str:
    return f"http://127.0.0.1:{server.server_address[1]}"


def client_of(server: Server) -> Client:
    return Client(address_of(server), timeout_s=5)


@pytest.mark.parametrize(("closes", "connections"), [(b"keep-alive", 1), (b"close", 3), (None, 3)])
def test_answers_come_whole_over_connections_kept_or_opened_anew(
    server: Server, closes: bytes | None, connections: int
) -> None:
    server.closes = closes
    client, call = client_of(server), Call("POST", "/pose", {"frame": bytes(range(256)) * 50})
    for _ in range(3):
        assert client.send(call) == (201, call.message[0])
        if closes is None:
            # Until the server has closed.
            client._connection.sock.recv(1, socket.MSG_PEEK)  # type: ignore[union-attr]
    assert server.connections == connections
    client.close()


def test_loops_count_every_request(server: Server) -> None:
    server.closes = b"keep-alive"
    url, request = address_of(server), Request(Call("POST", "/pose", {"frame": b"x"}))
    clients = [(Client(url), itertools.repeat(request)) for _ in range(2)]
    assert len(closed_loop(clients, 0.2).with_status(201)) >= 4
    few = [(Client(url), iter([request] * count)) for count in (2, 3)]
    assert closed_loop(few).statuses() == {"201": 5}
    server.breaks_off, server.closes = True, b"close"
    broken = closed_loop([(Client(url), iter([request] * 2))]).broken
    assert broken == ["IncompleteRead"] * 2
