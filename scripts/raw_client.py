"""A client that costs little itself: kept-alive connections and multipart bodies by hand."""

from __future__ import annotations

import select
import socket
from dataclasses import dataclass, field
from urllib.parse import urlsplit

_BOUNDARY = b"silhouette-pose-boundary"
_CONTENT_TYPE = f"multipart/form-data; boundary={_BOUNDARY.decode()}"
_RECEIVED_BYTES = 2**16


@dataclass(frozen=True)
class Call:
    """One request.

    Parameters
    ----------
    method, path : str
    parts : dict of str to bytes
        Form fields; those named like images are sent as files.
    headers : dict of str to str
        Further ones.
    """

    method: str
    path: str
    parts: dict[str, bytes] = field(default_factory=dict)
    headers: dict[str, str] = field(default_factory=dict)

    def body(self) -> bytes:
        """Encode the form."""
        out = []
        for name, value in self.parts.items():
            file = b"" if name in ("boxes", "api_key", "min_confidence") else b'; filename="f"'
            head = b'Content-Disposition: form-data; name="' + name.encode() + b'"' + file
            out.append(b"--" + _BOUNDARY + b"\r\n" + head + b"\r\n\r\n" + value + b"\r\n")
        return b"".join(out) + b"--" + _BOUNDARY + b"--\r\n"


def request_bytes(call: Call) -> bytes:
    """Write a request as it goes over the wire, to be sent as often as one likes."""
    head = [f"{call.method} {call.path} HTTP/1.1", "Host: localhost"]
    head += [f"{name}: {value}" for name, value in call.headers.items()]
    body = b""
    if call.method == "POST":
        body = call.body()
        head += [f"Content-Type: {_CONTENT_TYPE}", f"Content-Length: {len(body)}"]
    return "\r\n".join([*head, "", ""]).encode() + body


class RawClient:
    """Calls over one kept-alive connection, opened anew where the server closed it.

    Parameters
    ----------
    url : str
    timeout_s : float
        For the server to say anything.
    """

    def __init__(self, url: str, timeout_s: float = 30) -> None:
        parts = urlsplit(url)
        self._address = (parts.hostname or "", parts.port or 80)
        self._timeout_s = timeout_s
        self._socket: socket.socket | None = None

    def send(self, call: Call) -> tuple[int, bytes]:
        """Return status and body."""
        return self.exchange(request_bytes(call))

    def exchange(self, request: bytes) -> tuple[int, bytes]:
        """Send what :func:`request_bytes` wrote; return status and body.

        Raises
        ------
        OSError
            If the server closes the connection before its answer is complete, or is silent.
        """
        connection = self._connected()
        try:
            connection.sendall(request)
            return self._answer(connection)
        except OSError:
            self.close()
            raise

    def hang_up(self, call: Call) -> None:
        """Send a request and close the connection without waiting for the answer."""
        self._connected().sendall(request_bytes(call))
        self.close()

    def close(self) -> None:
        """Close the connection; the next call opens another."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self) -> socket.socket:
        # Between two answers there is nothing to read but that the server has closed.
        if self._socket is not None and select.select([self._socket], [], [], 0)[0]:
            self.close()
        if self._socket is None:
            self._socket = socket.create_connection(self._address, self._timeout_s)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._socket

    def _answer(self, connection: socket.socket) -> tuple[int, bytes]:
        received = bytearray()
        while (answer := whole_answer(received)) is None:
            some = connection.recv(_RECEIVED_BYTES)
            if not some:
                raise ConnectionError("the server closed the connection within its answer")
            received += some
        head, body = answer
        if header(head, b"connection") == b"close":
            self.close()
        return int(head[9:12]), body


def whole_answer(received: bytearray) -> tuple[bytes, bytes] | None:
    """First lines and body of an answer, or None where not all of it has come."""
    head_ends = received.find(b"\r\n\r\n")
    if head_ends < 0:
        return None
    head, body_starts = bytes(received[: head_ends + 2]), head_ends + 4
    if len(received) < body_starts + int(header(head, b"content-length") or b"0"):
        return None
    return head, bytes(received[body_starts:])


def header(head: bytes, name: bytes) -> bytes | None:
    """Value of a header, its name in lower case, in the first lines of an answer."""
    start = head.lower().find(b"\r\n" + name + b":")
    if start < 0:
        return None
    start += len(name) + 3
    return head[start : head.index(b"\r\n", start)].strip()
