"""One piece of work on a frame: whether it is still wanted, and where its time goes.

Work in a thread cannot be stopped from outside, so it checks now and then whether to go on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

STAGES = ("decode", "detect", "segment", "keypoints", "describe", "search")


@dataclass
class Stopwatch:
    """Milliseconds spent in each of :data:`STAGES`, and in all since its making."""

    milliseconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    _started: float = field(default_factory=time.perf_counter, repr=False)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.milliseconds[name] += (time.perf_counter() - started) * 1000

    def total(self) -> float:
        """Return the milliseconds since its making."""
        return (time.perf_counter() - self._started) * 1000


class BusyError(Exception):
    """The service has more to do than it can.

    Parameters
    ----------
    message : str
        One sentence for the caller.
    retry_after_s : int, optional
        When it is worth trying again; None where it is not.
    """

    reason = "busy"
    """One word for callers, logs and metrics."""

    def __init__(self, message: str, retry_after_s: int | None = 1) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class DeadlineError(BusyError):
    """The answer was not ready in time."""

    reason = "deadline"


class ClientGoneError(Exception):
    """The client has closed the connection."""

    def __init__(self) -> None:
        super().__init__("the client closed the connection")


class CancellationToken:
    """Tells work whether it is still wanted.

    Parameters
    ----------
    timeout_s : float
        Time left for the work.
    """

    def __init__(self, timeout_s: float) -> None:
        self._deadline = time.monotonic() + timeout_s
        self._cancelled = threading.Event()

    def check(self) -> None:
        """Raise :class:`ClientGoneError` or :class:`DeadlineError` once the work is unwanted."""
        if self._cancelled.is_set():
            raise ClientGoneError
        if time.monotonic() > self._deadline:
            raise DeadlineError("the frame took longer than the service allows")

    def cancel(self) -> None:
        """Make the next :meth:`check` raise."""
        self._cancelled.set()
