"""The work on one frame: whether it is still wanted, its time by stage, and help with its parts.

Work in a thread cannot be stopped from outside, so it checks now and then whether to continue.
"""

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

STAGES = ("decode", "detect", "segment", "keypoints", "describe", "search")


class BusyError(Exception):
    """The service has more work than it can do; the message is one sentence for the caller.

    A retry makes sense after ``retry_after_s``; none does if it is None.
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


ParallelMap = Callable[[Callable[[Any], Any], Iterable[Any]], list[Any]]
"""Calls a function with each item and returns the results in order."""


def serial_map(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Call a function with each item in turn; used without an executor."""
    return [function(item) for item in items]


class Job:
    """The work on one frame, with ``timeout_s`` left; ``parallel_map`` shares its parts."""

    def __init__(self, timeout_s: float = math.inf, parallel_map: ParallelMap = serial_map) -> None:
        self.stage_ms = dict.fromkeys(STAGES, 0.0)
        self.some_suffice = False
        """Whether an answer about some of the people is better than none."""
        self.left_out = 0
        """People who are seen but will not be in the answer."""
        self._started = time.perf_counter()
        self._timeout_s = timeout_s
        self._deadline = time.monotonic() + timeout_s
        self._cancelled = threading.Event()
        self._parallel_map = parallel_map

    def checkpoint(self) -> None:
        """Raise :class:`ClientGoneError` or :class:`DeadlineError` once the work is unwanted."""
        if self._cancelled.is_set():
            raise ClientGoneError
        if time.monotonic() > self._deadline:
            raise DeadlineError("the frame took longer than the service allows")

    def cancel(self) -> None:
        self._cancelled.set()

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Call a function with each part, in parallel, after a checkpoint; results are in order."""

        def checked(item: Item) -> Result:
            self.checkpoint()
            return function(item)

        return self._parallel_map(checked, items)

    def map_until(
        self, share: float, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> list[Result | None]:
        """The same for people, the best first; no call begins after this share of the time.

        None stands for those left out; the first never is. Unless some suffice, none are.
        """

        def in_time(numbered: tuple[int, Item]) -> Result | None:
            number, item = numbered
            if number and self.is_late(share):
                self.left_out += 1
                return None
            return function(item)

        return self.map(in_time, enumerate(items))

    def is_late(self, share: float) -> bool:
        """Whether some people suffice, and this share of the time is over."""
        left_s = self._deadline - time.monotonic()
        return self.some_suffice and left_s < (1 - share) * self._timeout_s

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to one of :data:`STAGES`."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.stage_ms[name] += (time.perf_counter() - started) * 1000

    def timings_ms(self) -> dict[str, float]:
        """Milliseconds by stage, and ``total`` since the job began."""
        return {**self.stage_ms, "total": (time.perf_counter() - self._started) * 1000}
