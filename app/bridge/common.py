"""Log lines, lasting faults and HTTP, for all parts of the bridge."""

import base64
import contextlib
import http.client
import json
import sys
import time
from urllib.parse import SplitResult, unquote

WAITS_S = (0.5, 1.0, 2.0, 5.0, 10.0)
RETRY_AFTER_S = 1.0


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
        print(time.strftime("%H:%M:%S"), text, file=sys.stderr, flush=True)


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


class Connection:
    """Requests to the host of an address, one after the other over one connection.

    Credentials in the address are sent with each request (basic authentication).
    """

    def __init__(self, address: SplitResult, timeout_s: float) -> None:
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
        try:
            self._connection.request(method, target, body, self._headers | headers)
            response = self._connection.getresponse()
            content = response.read()
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise UnavailableError(str(error) or type(error).__name__) from error
        if response.status < 300:
            return response.headers, content
        try:
            detail = str(json.loads(content)["detail"])
        except (ValueError, KeyError, TypeError):
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
