"""Work on images: a few threads, a short queue before them, and a way out of both."""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

import anyio
from anyio import CapacityLimiter, to_thread

from app.process import give_way

T = TypeVar("T")

FULL = "the service is working to capacity; try again shortly"


class OverloadedError(Exception):
    """The queue is full."""


class DeadlineError(Exception):
    """The answer was not ready in time."""


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
            raise ClientGoneError("the client closed the connection")
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
        self._threads = CapacityLimiter(threads)
        self._capacity = threads + queue_length
        self._timeout_s = timeout_s
        self.inside = 0
        """Jobs that run or wait."""

    def is_full(self) -> bool:
        """Whether one job more would be refused."""
        return self.inside >= self._capacity

    async def run(self, work: Callable[[Watch], T], until_gone: Callable[[], Awaitable[None]]) -> T:
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

        def job() -> T:
            give_way()
            return work(watch)

        outcome: T | None = None
        failure: Exception | None = None
        finished = False
        self.inside += 1
        try:
            with anyio.move_on_after(self._timeout_s):
                async with anyio.create_task_group() as tasks:

                    async def tell_when_gone() -> None:
                        await until_gone()
                        watch.client_is_gone()
                        tasks.cancel_scope.cancel()

                    tasks.start_soon(tell_when_gone)
                    try:
                        outcome = await to_thread.run_sync(job, limiter=self._threads)
                        finished = True
                    except Exception as error:
                        # Kept for later, as a task group would wrap it into a group.
                        failure = error
                    tasks.cancel_scope.cancel()
        finally:
            self.inside -= 1
        if failure is not None:
            raise failure
        if not finished:
            watch.check()
            raise DeadlineError("the service was too busy to answer in time; try again shortly")
        return outcome  # type: ignore[return-value]
