"""The bridge between cameras and a service: frames in, events out; see :mod:`app.bridge.__main__`.

Here are its log lines and faults.
"""

import contextlib
import math
import sys
import threading
import time

WAITS_S = (0.5, 1.0, 2.0, 5.0, 10.0)
RETRY_AFTER_S = 1.0
_MAX_CHARACTERS = 500
_SAME_AFTER_S = 60.0


class UnavailableError(Exception):
    """A server cannot take a request now, but may take it later."""


class RefusedError(Exception):
    """A server refuses a request; the message says why."""

    def __init__(self, detail: str, status: int, retry_after_s: float = 0.0) -> None:
        super().__init__(detail)
        self.status, self.retry_after_s = status, retry_after_s


def say(text: str) -> None:
    """Print a line with the time of day to standard error; standard output is for events alone.

    It names the camera, as the threads of a camera are called.
    """
    name = threading.current_thread().name
    camera = "" if name == threading.main_thread().name else f"{name}: "
    line = f"{time.strftime('%H:%M:%S')} {camera}{printable(text)}\n"
    with contextlib.suppress(OSError):  # A log on a full disk ends nothing.
        print(line, end="", file=sys.stderr, flush=True)


def printable(text: str) -> str:
    """Return another program's text as it may be printed: short, and without control codes."""
    short = text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]} ..."
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in short)


class Trouble:
    """A fault that lasts: reported when it begins, when it changes and when it is over.

    One that comes and goes, as of a service with too many cameras, is reported once a minute.
    """

    def __init__(self, over: str) -> None:
        self._over, self._text, self._is_said, self._failures = over, "", False, 0
        self._last_said, self._said_at = "", -math.inf

    def report(self, text: str) -> float:
        """Report what is wrong, if that is new; return the seconds to wait before the next try."""
        if text != self._text:
            now = time.monotonic()
            self._is_said = text != self._last_said or now - self._said_at >= _SAME_AFTER_S
            if self._is_said:
                say(text)
                self._last_said, self._said_at = text, now
        self._text, self._failures = text, self._failures + 1
        return WAITS_S[min(self._failures, len(WAITS_S)) - 1]

    def end(self) -> None:
        """Report the end of the fault, if there was one that was reported."""
        if self._is_said:
            say(self._over)
        self._text, self._is_said, self._failures = "", False, 0
