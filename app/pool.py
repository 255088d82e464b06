"""Work on images: a few threads, a short queue before them, and a way out of both."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from app.process import give_back_what_is_free, give_way

T = TypeVar("T")

FULL = "the service is working to capacity; try again shortly"
_LONG_S = 0.05
# Of the running mean of how long a job takes.
_NEWEST_COUNTS = 0.2
_GONE = "the client closed the connection"
_BUSY = "the service was too busy to answer in time; try again shortly"


class BusyError(Exception):
    """The service has more to do than it can; the message is one sentence for the caller."""

    reason = "busy"
    """One word for logs and metrics."""


class OverloadedError(BusyError):
    """The queue is full."""

    reason = "queue_full"


class DeadlineError(BusyError):
    """The answer was not ready in time."""

    reason = "deadline"


class ClientGoneError(Exception):
    """Whoever asked has hung up."""


class Watch:
    """Tells work in a thread whether it is still wanted; a thread cannot be stopped from outside.

    Parameters
    ----------
    timeout_s : float
        Time left for the work.
    """

    def __init__(self, timeout_s: float) -> None:
        self._deadline = time.monotonic() + timeout_s
        self._gone = threading.Event()

    def check(self) -> None:
        """Raise :class:`ClientGoneError` or :class:`DeadlineError` once the work is unwanted."""
        if self._gone.is_set():
            raise ClientGoneError(_GONE)
        if time.monotonic() > self._deadline:
            raise DeadlineError("the frame took longer than the service allows")

    def client_is_gone(self) -> None:
        """Make the next :meth:`check` raise."""
        self._gone.set()


class WorkPool:
    """A bounded number of threads with a bounded queue.

    Parameters
    ----------
    threads : int
        Jobs that run at once.
    queue_length : int
        Jobs that may wait; one more is refused at once.
    timeout_s : float
        From being asked to being done, waiting included.
    """

    def __init__(self, threads: int, queue_length: int, timeout_s: float) -> None:
        self._count = threads
        self._threads = ThreadPoolExecutor(
            threads, thread_name_prefix="frame", initializer=give_way
        )
        self._capacity = threads + queue_length
        self._timeout_s = timeout_s
        self._usual_s = 0.0
        self.inside = 0
        """Jobs that run or wait."""

    @property
    def capacity(self) -> int:
        """Jobs that may run or wait at once."""
        return self._capacity

    def is_full(self) -> bool:
        """Whether one job more would be refused."""
        return self.inside >= self._capacity

    def retry_after_s(self) -> int:
        """Seconds until the jobs inside are probably done, at least 1, at most the timeout."""
        needed_s = self.inside * self._usual_s / self._count
        return max(1, math.ceil(min(needed_s, self._timeout_s)))

    def _do(self, work: Callable[[Watch], T], watch: Watch) -> T:
        started = time.monotonic()
        try:
            return work(watch)
        finally:
            took_s = time.monotonic() - started
            self._usual_s += _NEWEST_COUNTS * (took_s - self._usual_s)
            # What took long took much memory, some ten megabytes of which stay behind.
            if took_s > _LONG_S:
                give_back_what_is_free()

    async def run(
        self, work: Callable[[Watch], T], until_gone: Callable[[], Coroutine[None, None, None]]
    ) -> T:
        """Do ``work`` in a thread.

        Parameters
        ----------
        work : callable
            Calls :meth:`Watch.check` between its steps.
        until_gone : async callable
            Returns when the client has hung up. Work that waits is then dropped, work that
            runs is told.

        Raises
        ------
        OverloadedError, DeadlineError, ClientGoneError
        """
        if self.is_full():
            raise OverloadedError(FULL)
        watch = Watch(self._timeout_s)
        self.inside += 1
        # The log lines of the work carry the request's id.
        job = self._threads.submit(copy_context().run, self._do, work, watch)
        done, gone = asyncio.wrap_future(job), asyncio.ensure_future(until_gone())
        try:
            await asyncio.wait(
                (done, gone), timeout=self._timeout_s, return_when=asyncio.FIRST_COMPLETED
            )
            if gone.done():
                watch.client_is_gone()
            if job.cancel():  # It still waited.
                raise ClientGoneError(_GONE) if gone.done() else DeadlineError(_BUSY)
            # Whether it is told or not, a thread is taken until it ends.
            return await done
        finally:
            watch.client_is_gone()
            gone.cancel()
            self.inside -= 1
