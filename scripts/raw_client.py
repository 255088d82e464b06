"""A client that costs little itself: kept-alive connections and multipart bodies by hand."""

from __future__ import annotations

import http.client
from dataclasses import dataclass, field
from urllib.parse import urlsplit

_BOUNDARY = b"silhouette-pose-boundary"
_CONTENT_TYPE = f"multipart/form-data; boundary={_BOUNDARY.decode()}"


@dataclass(frozen=True)
class Call:
    """One request.

    Parameters
    ----------
    method, path : str
    parts : dict of str to bytes
        Form fields; those named like images are sent as files.
    """

    method: str
    path: str
    parts: dict[str, bytes] = field(default_factory=dict)

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
    """

    def __init__(self, url: str, timeout_s: float = 30) -> None:
        parts = urlsplit(url)
        self._connection = http.client.HTTPConnection(
            parts.hostname or "", parts.port, timeout=timeout_s
        )

    def send(self, call: Call) -> tuple[int, bytes]:
        """Return status and body."""
        headers = {}
        body = None
        if call.method == "POST":
            headers["Content-Type"] = _CONTENT_TYPE
            body = call.body()
        try:
            self._connection.request(call.method, call.path, body, headers)
            response = self._connection.getresponse()
            return response.status, response.read()
        except (http.client.HTTPException, OSError):
            self._connection.close()
            raise

    def hang_up(self, call: Call) -> None:
        """Send a request and close the connection without waiting for the answer."""
        body = call.body()
        headers = {"Content-Type": _CONTENT_TYPE}
        self._connection.request(call.method, call.path, body, headers)
        self._connection.close()
