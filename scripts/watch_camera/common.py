"""Connections and log lines of the bridge."""

from __future__ import annotations

import http.client
import sys
import time
from urllib.parse import SplitResult


def connection_to(parts: SplitResult, timeout_s: float) -> http.client.HTTPConnection:
    """Return a connection to the host of a URL, opened by its first request."""
    secure = parts.scheme == "https"
    connect = http.client.HTTPSConnection if secure else http.client.HTTPConnection
    return connect(parts.netloc.rpartition("@")[2], timeout=timeout_s)


def say(text: str) -> None:
    """Print a line with the time of day to standard error; standard output is for events alone."""
    print(time.strftime("%H:%M:%S"), text, file=sys.stderr, flush=True)
