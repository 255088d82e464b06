"""HAProxy with ``deploy/haproxy.cfg`` finds replicas by name, as in Kubernetes."""

from __future__ import annotations

import random
import re
import shutil
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest

from tests.support.balancer import CONFIGURATION, Balancer
from tests.support.programs import output_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        shutil.which("haproxy") is None, reason="needs HAProxy: apt-get install haproxy"
    ),
]

CAMERAS = [f"yard-{number}" for number in range(30)]
ADDRESSES = ["127.0.0.1", "127.0.0.2", "127.0.0.3"]
A, NO_ERROR = 1, 0x8180


class NameServer:
    """Answers any question for addresses with the same ones, in another order each time."""

    def __init__(self, addresses: list[str]) -> None:
        self.addresses = list(addresses)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                query, client = self._socket.recvfrom(4096)
            except OSError:
                return
            end = query.index(b"\0", 12) + 5
            kind = struct.unpack("!H", query[end - 4 : end - 2])[0]
            known = random.sample(self.addresses, len(self.addresses)) if kind == A else []
            header = query[:2] + struct.pack("!5H", NO_ERROR, 1, len(known), 0, 0)
            records = b"".join(
                struct.pack("!3HIH", 0xC00C, A, 1, 1, 4) + socket.inet_aton(address)
                for address in known
            )
            self._socket.sendto(header + query[12:end] + records, client)

    def close(self) -> None:
        self._socket.close()


class TellsItsAddress(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        address = str(self.server.server_address[0]).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(address)))
        self.end_headers()
        self.wfile.write(address)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def names() -> Iterator[NameServer]:
    names = NameServer(ADDRESSES)
    yield names
    names.close()


@pytest.fixture
def port() -> Iterator[int]:
    """The port of a server on each of the addresses."""
    with ExitStack() as stack:
        port = 0
        for address in ADDRESSES:
            server = stack.enter_context(ThreadingHTTPServer((address, port), TellsItsAddress))
            port = server.server_address[1]
            threading.Thread(target=server.serve_forever, daemon=True).start()
            stack.callback(server.shutdown)
        yield port


@pytest.fixture
def balancer(names: NameServer, port: int, tmp_path: Path) -> Balancer:
    text = CONFIGURATION.read_text()
    assert text.count("parse-resolv-conf\n") == 1
    configuration = tmp_path / "haproxy.cfg"
    configuration.write_text(
        text.replace("parse-resolv-conf\n", f"nameserver test 127.0.0.1:{names.port}\n")
    )
    return Balancer(configuration=configuration, REPLICAS_DNS=f"replicas.test:{port}")


def places(balancer: Balancer) -> dict[str, str]:
    """The replica that answers each camera."""
    with httpx.Client(base_url=balancer.url) as client:
        return {name: client.get(f"/cameras/{name}").text for name in CAMERAS}


def wait_for(balancer: Balancer, addresses: set[str]) -> dict[str, str]:
    """Replicas of the cameras, stable for two rounds, once these replicas share them."""
    deadline = time.monotonic() + 20
    before, found = None, places(balancer)
    while found != before or set(found.values()) != addresses:
        assert time.monotonic() < deadline, found
        time.sleep(0.1)
        before, found = found, places(balancer)
    return found


def test_cameras_move_only_when_replicas_change(names: NameServer, balancer: Balancer) -> None:
    with balancer:
        before = wait_for(balancer, set(ADDRESSES))
        assert places(balancer) == before
        gone = ADDRESSES[-1]
        names.addresses.remove(gone)
        without = wait_for(balancer, set(ADDRESSES) - {gone})
        stayed = {name for name in CAMERAS if before[name] != gone}
        assert {name: without[name] for name in stayed} == {name: before[name] for name in stayed}
        names.addresses.append(gone)
        assert wait_for(balancer, set(ADDRESSES)) == before


def version() -> tuple[int, ...]:
    found = re.search(r"version (\d+)\.(\d+)", output_of("haproxy", "-v"))
    assert found is not None
    return tuple(map(int, found.groups()))


def test_two_balancers_agree(names: NameServer, balancer: Balancer) -> None:
    if version() < (3, 0):
        pytest.skip("needs HAProxy 3.0, which hashes by address")
    with balancer:
        before = wait_for(balancer, set(ADDRESSES))
    with balancer:
        assert wait_for(balancer, set(ADDRESSES)) == before
