"""The threads that do all work on images, in two roles.

Frames (:meth:`Executor.run`)
    Whole requests: a bounded number at a time, the others in
    :class:`app.scheduling.queue.FairQueue`. A frame has a deadline and is dropped when its client
    disconnects.
Parts (:meth:`Executor.map`)
    The people of a frame, or its images. The frame's own thread works through them. While fewer
    frames are worked on than are allowed, idle threads take parts one at a time, from each frame in
    turn. A new frame never waits for them: it gets its own thread, and as soon as it needs the
    cores, the other threads stop taking parts.

Work on a frame must not start another frame, and work on a part must not start parts: either would
wait for threads that may never be free.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Hashable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from contextvars import ContextVar, copy_context
from typing import Any, Generic, Literal, TypeVar

from app.scheduling.job import ClientGoneError, Job
from app.scheduling.process import lower_thread_priority, trim_heap
from app.scheduling.queue import FairQueue, Ticket

T = TypeVar("T")
Item = TypeVar("Item")
Result = TypeVar("Result")

_TRIM_EVERY_S = 10.0

_role: ContextVar[Literal["", "frame", "part"]] = ContextVar("role", default="")


class _Parts(Generic[Item, Result]):
    """The parts of one frame, each done by the thread that takes it."""

    def __init__(self, function: Callable[[Item], Result], items: Iterable[Item]) -> None:
        self._function = function
        self._context = copy_context()
        self._left = deque((item, Future[Result]()) for item in items)
        self._futures = [future for _, future in self._left]

    def __len__(self) -> int:
        return len(self._left)

    def do_next(self) -> bool:
        """Work on the next part; return False if none is left."""
        try:
            item, future = self._left.popleft()
        except IndexError:
            return False
        try:
            # Each thread needs a copy: a context cannot be entered twice at once.
            result = self._context.copy().run(self._as_part, item)
        except BaseException as error:
            future.set_exception(error)
            while self._left:
                self._left.popleft()[1].set_exception(error)
            # Otherwise the error's traceback would keep the future, and the future the error.
            del future
        else:
            future.set_result(result)
        return True

    def results(self) -> list[Result]:
        """Wait for the parts that other threads have taken; raise the first error."""
        wait(self._futures)
        try:
            return list(map(Future.result, self._futures))
        finally:
            # Otherwise the error would keep the futures, they the error, and both the frame.
            self._futures.clear()

    def _as_part(self, item: Item) -> Result:
        _role.set("part")
        return self._function(item)


class Executor:
    """Works on a bounded number of frames at a time; the others wait in a queue.

    Parameters
    ----------
    frames : int
        Largest number worked on at a time. Threads start when needed.
    max_wait_s : float
        Longest wait of a frame until its work begins.
    timeout_s : float
        Longest time for a frame, waiting included.
    """

    def __init__(self, frames: int, max_wait_s: float, timeout_s: float) -> None:
        self.queue = FairQueue(frames, min(max_wait_s, timeout_s))
        self._timeout_s = timeout_s
        # There are more threads than frames because helpers finish their parts while new frames
        # begin.
        self._threads = ThreadPoolExecutor(
            2 * frames - 1, thread_name_prefix="work", initializer=lower_thread_priority
        )
        self._jobs: set[Job] = set()
        self._lock = threading.Lock()
        self._helping = 0
        self._trimmed_at = -math.inf
        self._divided: deque[_Parts[Any, Any]] = deque()

    async def run(
        self,
        work: Callable[[Job], T],
        until_gone: Callable[[], Coroutine[None, None, None]],
        *,
        caller: Hashable,
        kind: Hashable = None,
        camera: Hashable = None,
        unbounded_wait: bool = False,
    ) -> T:
        """Work on a frame in a thread.

        Parameters
        ----------
        work : callable
            The work on the frame; it calls :meth:`Job.checkpoint` between its steps.
        until_gone : async callable
            Returns when the client has disconnected. A waiting frame is then dropped, and work that
            has begun is cancelled.
        caller, kind, camera, unbounded_wait
            See :meth:`app.scheduling.queue.FairQueue.enqueue`.

        Raises
        ------
        OverloadedError, DeadlineError, SupersededError, ClientGoneError
        RuntimeError
            If work on a frame calls this.
        """
        if _role.get():
            raise RuntimeError("expected a frame to be started by a request, not by another frame")
        enqueued = time.monotonic()
        ticket = self.queue.enqueue(caller, kind, camera, unbounded_wait=unbounded_wait)
        gone = asyncio.ensure_future(until_gone())
        try:
            await self._until_begun(ticket, gone, None if unbounded_wait else self.queue.max_wait_s)
            waited_s = 0.0 if unbounded_wait else time.monotonic() - enqueued
            return await self._work(ticket, work, Job(self._timeout_s - waited_s, self.map), gone)
        finally:
            gone.cancel()

    async def _until_begun(
        self, ticket: Ticket, gone: asyncio.Future[None], max_wait_s: float | None
    ) -> None:
        """Wait until a frame may begin; if it may not, release its ticket and raise the error."""
        try:
            await _first_of(ticket.begun, gone, max_wait_s)
            if not ticket.begun.done():
                raise ClientGoneError if gone.done() else self.queue.expire(ticket)
            if (make_error := ticket.begun.result()) is not None:
                raise make_error()
        except BaseException:
            self.queue.release(ticket)
            raise

    async def _work(
        self, ticket: Ticket, work: Callable[[Job], T], job: Job, gone: asyncio.Future[None]
    ) -> T:
        """Work on a begun frame; its ticket is released once the thread is free."""
        done = asyncio.wrap_future(self._begin(ticket, work, job))
        # If this is cancelled, nobody else asks for the error, which asyncio would log.
        done.add_done_callback(_retrieve_error)
        try:
            await _first_of(done, gone)
            if not done.done():
                job.cancel()
            # Cancelled or not, the work occupies a thread until it ends.
            return await done
        finally:
            job.cancel()
            # Otherwise the error would keep the future, the future the error, and both the frame.
            del done

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Call a function with each part of a frame and return the results in order.

        Raises
        ------
        RuntimeError
            If the function, or anything it calls, calls this again.
        """
        if _role.get() == "part":
            raise RuntimeError("expected a part of a frame not to be divided again")
        parts = _Parts(function, items)
        helpers = min(len(parts), self.queue.threads) - 1
        if helpers > 0:
            with self._lock:
                self._divided.append(parts)
            for _ in range(helpers):
                self._threads.submit(self._help)
        while parts.do_next():
            pass
        return parts.results()

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Call a function that does no work on a frame, such as loading the index."""
        return self._threads.submit(function)

    def shut_down(self) -> None:
        """Cancel all jobs and wait for the threads to end."""
        self.queue.close()
        for job in tuple(self._jobs):
            job.cancel()
        self._threads.shutdown(cancel_futures=True)

    def _begin(self, ticket: Ticket, work: Callable[[Job], T], job: Job) -> Future[T]:
        loop, context = asyncio.get_running_loop(), copy_context()
        future = self._threads.submit(context.run, self._as_frame, work, job)
        self._jobs.add(job)

        def end(future: Future[T]) -> None:
            self._jobs.discard(job)
            worked = not future.cancelled() and future.exception() is None
            with suppress(RuntimeError):  # The loop has ended.
                loop.call_soon_threadsafe(self._end, ticket, worked)

        future.add_done_callback(end)
        return future

    def _as_frame(self, work: Callable[[Job], T], job: Job) -> T:
        _role.set("frame")
        try:
            return work(job)
        finally:
            # Some ten megabytes stay behind. The next frame needs them again, and it takes as long
            # as a tenth of its work to get them back from the system.
            now = time.monotonic()
            if now - self._trimmed_at > _TRIM_EVERY_S:
                self._trimmed_at = now
                trim_heap()

    def _end(self, ticket: Ticket, worked: bool) -> None:
        self.queue.release(ticket, worked=worked)
        if self._divided:
            with suppress(RuntimeError):  # The threads are being shut down.
                self._threads.submit(self._help)

    def _help(self) -> None:
        """Work on parts of other frames while fewer frames than allowed are worked on."""
        while (parts := self._next_divided()) is not None:
            parts.do_next()
            with self._lock:
                self._helping -= 1

    def _next_divided(self) -> _Parts[Any, Any] | None:
        """Return the divided frame whose turn it is, if a helper may take one of its parts."""
        with self._lock:
            while self._divided and self.queue.working + self._helping < self.queue.threads:
                parts = self._divided.popleft()
                if len(parts):
                    self._divided.append(parts)
                    self._helping += 1
                    return parts
        return None


def _retrieve_error(done: asyncio.Future[Any]) -> None:
    if not done.cancelled():
        done.exception()


async def _first_of(
    one: asyncio.Future[Any], other: asyncio.Future[Any], timeout_s: float | None = None
) -> None:
    await asyncio.wait((one, other), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
