"""Log lines, lasting faults and HTTP, for all parts of the bridge."""

import base64
import contextlib
import http.client
import io
import json
import socket
import sys
import time
from functools import partial
from typing import Any
from urllib.parse import SplitResult, unquote

WAITS_S = (0.5, 1.0, 2.0, 5.0, 10.0)
RETRY_AFTER_S = 1.0
_MAX_CHARACTERS = 500


class UnavailableError(Exception):
    """A server cannot take a request now, but may take it later."""


class RefusedError(Exception):
    """A server refuses a request; the message says why."""

    def __init__(self, detail: str, status: int, retry_after_s: float = 0.0) -> None:
        super().__init__(detail)
        self.status, self.retry_after_s = status, retry_after_s


def say(text: str) -> None:
    """Print a line with the time of day to standard error; standard output is for events alone."""
    with contextlib.suppress(OSError):  # A log on a full disk ends nothing.
        print(time.strftime("%H:%M:%S"), printable(text), file=sys.stderr, flush=True)


def printable(text: str) -> str:
    """Return another program's text as it may be printed: short, and without control codes."""
    short = text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]} ..."
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in short)


class Trouble:
    """A fault that lasts: reported when it begins, when it changes and when it is over."""

    def __init__(self, over: str) -> None:
        self._over, self._said, self._failures = over, "", 0

    def report(self, text: str) -> float:
        """Report what is wrong, if that is new; return the seconds to wait before the next try."""
        if text != self._said:
            say(text)
        self._said, self._failures = text, self._failures + 1
        return WAITS_S[min(self._failures, len(WAITS_S)) - 1]

    def end(self) -> None:
        """Report the end of the fault, if there was one."""
        if self._said:
            say(self._over)
        self._said, self._failures = "", 0


class _TimedReader(io.RawIOBase):
    """What a socket receives until a deadline, however slowly it comes."""

    def __init__(self, received: io.RawIOBase, connection: socket.socket, deadline: float) -> None:
        self._received, self._connection, self._deadline = received, connection, deadline

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        left_s = self._deadline - time.monotonic()
        if left_s <= 0:
            raise TimeoutError("the answer took too long")
        self._connection.settimeout(left_s)
        return self._received.readinto(buffer)

    def close(self) -> None:
        self._received.close()
        super().close()


class _TimedResponse(http.client.HTTPResponse):
    """An answer, from its head on, that has to come until a deadline."""

    def __init__(self, sock: socket.socket, *given: Any, deadline: float, **named: Any) -> None:
        super().__init__(sock, *given, **named)
        self.fp = io.BufferedReader(_TimedReader(self.fp.detach(), sock, deadline))


class Connection:
    """Requests to the host of an address, one after the other over one connection.

    Credentials in the address are sent with each request (basic authentication), so redirects are
    not followed. An answer may take ``timeout_s``; of a longer one, ``max_bytes`` are read.
    """

    def __init__(self, address: SplitResult, timeout_s: float, max_bytes: int) -> None:
        self._timeout_s, self._max_bytes = timeout_s, max_bytes
        secure = address.scheme == "https"
        connect = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        port = address.port or (443 if secure else 80)
        self._connection = connect(address.hostname or "", port, timeout=timeout_s)
        self._headers = {}
        if address.username is not None:
            pair = f"{unquote(address.username)}:{unquote(address.password or '')}"
            encoded = base64.b64encode(pair.encode()).decode()
            self._headers["Authorization"] = f"Basic {encoded}"

    def request(
        self, method: str, target: str, body: bytes | None, headers: dict[str, str]
    ) -> tuple[http.client.HTTPMessage, bytes]:
        """Return headers and content of an answer.

        Raises ``UnavailableError`` if there is none, ``RefusedError`` for a status of 300 or more.
        """
        connection = self._connection
        if connection.sock:
            connection.sock.settimeout(self._timeout_s)
        try:
            connection.request(method, target, body, self._headers | headers)
            deadline = time.monotonic() + self._timeout_s
            timed: Any = partial(_TimedResponse, deadline=deadline)
            connection.response_class = timed
            response = connection.getresponse()
            content = response.read(self._max_bytes)
            if not response.isclosed():
                self.close()  # The rest is not read.
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise UnavailableError(str(error) or type(error).__name__) from error
        if response.status < 300:
            return response.headers, content
        try:
            if response.status < 400:
                place = response.headers.get("Location", "nowhere")
                detail = f"expected an answer, got a redirect, which is not followed, to {place}"
            else:
                detail = str(json.loads(content)["detail"])
        except (ValueError, KeyError, TypeError, RecursionError):
            detail = response.reason
        after = response.headers.get("Retry-After", "")
        wait_s = RETRY_AFTER_S if response.status > 500 else 0.0
        raise RefusedError(
            f"{detail} ({response.status})",
            response.status,
            float(after) if after.isdecimal() else wait_s,
        )

    def close(self) -> None:
        """Close the connection; the next request opens another one."""
        self._connection.close()
