"""Work on images: a few threads, a short queue before them, and a way out of both.

A job of a live camera that still waits gives its place in the queue to the next one of the same
camera: an answer that comes late is worth less than one to a newer frame.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable, Coroutine, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import Context, copy_context
from dataclasses import dataclass, field
from typing import Any, TypeVar

from app.process import give_back_what_is_free, give_way

T = TypeVar("T")

FULL = "the service is working to capacity; try again shortly"
_LONG_S = 0.05
# Of the running mean of how long a job takes.
_NEWEST_COUNTS = 0.2
_GONE = "the client closed the connection"
_SUPERSEDED = "a newer frame of this camera has taken the place of this one, which still waited"
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


class SupersededError(BusyError):
    """A newer frame of the same camera has taken the place of this one."""

    reason = "superseded"


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


@dataclass(eq=False)
class _Job:
    """Work, whom it is for, and its result."""

    work: Callable[[Watch], Any]
    watch: Watch
    context: Context = field(default_factory=copy_context)
    future: Future[Any] = field(default_factory=Future)


class _Place:
    """A place in the queue, whose job may be replaced until its turn comes.

    Jobs are replaced by the thread that answers requests, and begun by those that work.

    Parameters
    ----------
    job : _Job
    """

    def __init__(self, job: _Job) -> None:
        self.job = job
        self._begun = False
        self._lock = threading.Lock()

    def begin(self) -> _Job | None:
        """Return the job that has its turn, None if nobody waits for it any longer."""
        with self._lock:
            self._begun = True
            return self.job if self.job.future.set_running_or_notify_cancel() else None

    def is_replaceable(self) -> bool:
        """Whether its job still waits."""
        return not self._begun and not self.job.future.cancelled()

    def replace(self, job: _Job) -> bool:
        """Put another job in the place of the one that waits; False if that has begun."""
        with self._lock:
            if not self.is_replaceable():
                return False
            superseded, self.job = self.job, job
        superseded.future.set_exception(SupersededError(_SUPERSEDED))
        return True


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
        self._newest: dict[Hashable, _Place] = {}
        self.inside = 0
        """Jobs that run or wait."""

    @property
    def capacity(self) -> int:
        """Jobs that may run or wait at once."""
        return self._capacity

    def is_full(self, camera: Hashable = None) -> bool:
        """Whether one job more, of this camera if it is of one, would be refused."""
        if self.inside < self._capacity:
            return False
        newest = self._newest.get(camera)
        return newest is None or not newest.is_replaceable()

    def retry_after_s(self) -> int:
        """Seconds until the jobs inside are probably done, at least 1, at most the timeout."""
        needed_s = self.inside * self._usual_s / self._count
        return max(1, math.ceil(min(needed_s, self._timeout_s)))

    async def run(
        self,
        work: Callable[[Watch], T],
        until_gone: Callable[[], Coroutine[None, None, None]],
        camera: Hashable = None,
    ) -> T:
        """Do ``work`` in a thread.

        Parameters
        ----------
        work : callable
            Calls :meth:`Watch.check` between its steps.
        until_gone : async callable
            Returns when the client has hung up. Work that waits is then dropped, work that
            runs is told.
        camera : hashable, optional
            Of a live camera: work of the same one that still waits is superseded.

        Raises
        ------
        OverloadedError, DeadlineError, SupersededError, ClientGoneError
        """
        job = _Job(work, Watch(self._timeout_s))
        place = self._place(job, camera)
        done: asyncio.Future[T] = asyncio.wrap_future(job.future)
        gone = asyncio.ensure_future(until_gone())
        try:
            await asyncio.wait(
                (done, gone), timeout=self._timeout_s, return_when=asyncio.FIRST_COMPLETED
            )
            if gone.done():
                job.watch.client_is_gone()
            if job.future.cancel():  # It still waited.
                raise ClientGoneError(_GONE) if gone.done() else DeadlineError(_BUSY)
            # Whether it is told or not, a thread is taken until it ends.
            return await done
        finally:
            job.watch.client_is_gone()
            job.future.cancel()
            gone.cancel()
            if place.job is job:
                self._leave(place, camera)

    def _place(self, job: _Job, camera: Hashable) -> _Place:
        """Return the job's place: that of the camera's last one if it still waits, else a new one.

        A camera so keeps its turn, however often it sends.
        """
        newest = self._newest.get(camera)
        if newest is not None and newest.replace(job):
            return newest
        if self.inside >= self._capacity:
            raise OverloadedError(FULL)
        place = _Place(job)
        self.inside += 1
        if camera is not None:
            self._newest[camera] = place
        self._threads.submit(self._work_off, place)
        return place

    def _leave(self, place: _Place, camera: Hashable) -> None:
        self.inside -= 1
        if self._newest.get(camera) is place:
            del self._newest[camera]

    def _work_off(self, place: _Place) -> None:
        job = place.begin()
        if job is None:
            return
        try:
            # The log lines of the work carry the request's id.
            result = job.context.run(self._do, job.work, job.watch)
        except BaseException as error:
            job.future.set_exception(error)
            # Else the error would keep the job, the job the error, and both of them the frame.
            del job, place
        else:
            job.future.set_result(result)

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
