"""A client that asks for another protocol and hides a request in its body, through a proxy."""

import socket
import time
from collections.abc import Callable

import httpx

from tests.conftest import Photo
from tests.support.service import send

_HIDDEN = b"DELETE /cameras/target HTTP/1.1\r\nHost: localhost\r\n\r\n"
_FRAMINGS = (
    (b"Content-Length: %d" % len(_HIDDEN), _HIDDEN),
    (b"Transfer-Encoding: chunked", b"%x\r\n%s\r\n0\r\n\r\n" % (len(_HIDDEN), _HIDDEN)),
)


def check_hidden_requests(
    client: httpx.Client, connect: Callable[[], socket.socket], photo: Photo
) -> None:
    """What is hidden is not carried out, and every client gets the answers to its own requests."""
    send(client, photo, "target")
    send(client, photo, "another")
    for protocol in (b"h2c", b"websocket"):
        for framing, body in _FRAMINGS:
            for pause_s in (0.0, 0.05):
                head = (
                    b"POST /cameras/attacker/frames HTTP/1.1\r\nHost: localhost\r\n"
                    b"Content-Type: image/jpeg\r\nConnection: Upgrade\r\nUpgrade: %s\r\n%s\r\n\r\n"
                ) % (protocol, framing)
                with connect() as connection:
                    connection.settimeout(20)
                    connection.sendall(head)
                    time.sleep(pause_s)
                    connection.sendall(body)
                    # nginx and HAProxy send what they think right of the request.
                    assert connection.recv(65_536).split()[1] in (b"400", b"501")
                    for camera in ("target", "another"):
                        answer = client.get(f"/cameras/{camera}")
                        assert answer.status_code == 200
                        assert answer.json()["camera_id"] == camera
