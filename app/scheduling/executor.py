"""The threads that do all work on images, in two roles.

Frames (:meth:`Executor.run`)
    Whole requests: a bounded number at a time, the others in a queue. A frame has a deadline and is
    dropped when its client disconnects. It must not start another frame.
Parts (:meth:`Executor.map`)
    The people of a frame, or its images, on the frame's own thread. While fewer frames are in
    progress than are allowed, helpers take parts too; a new frame never waits for them.
"""

import asyncio
import time
from collections.abc import Callable, Coroutine, Hashable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from contextvars import copy_context
from functools import partial
from typing import TypeVar

from app.scheduling.job import ClientGoneError, Job
from app.scheduling.process import lower_thread_priority
from app.scheduling.queue import FairQueue, Ticket

T = TypeVar("T")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor:
    """Processes a bounded number of frames at a time.

    A frame waits at most ``max_wait_s``, and takes at most ``timeout_s``, waiting included.
    """

    def __init__(self, frames: int, max_wait_s: float, timeout_s: float) -> None:
        self.queue = FairQueue(frames, min(max_wait_s, timeout_s))
        self._timeout_s = timeout_s
        helpers, lower = max(1, frames - 1), lower_thread_priority
        self._threads = ThreadPoolExecutor(frames, "frame", initializer=lower)
        self._helpers = ThreadPoolExecutor(helpers, "helper", initializer=lower)
        self._jobs: set[Job] = set()

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
        """Work on a frame in a thread; ``work`` calls :meth:`Job.checkpoint` between its steps.

        ``until_gone`` returns when the client has disconnected: a waiting frame is then dropped,
        while work that has begun is finished. The rest is as in
        :meth:`app.scheduling.queue.FairQueue.enqueue`.

        Raises OverloadedError, DeadlineError, SupersededError and ClientGoneError.
        """
        enqueued = time.monotonic()
        ticket = self.queue.enqueue(caller, kind, camera, unbounded_wait=unbounded_wait)
        gone = asyncio.ensure_future(until_gone())
        try:
            await self._until_begun(ticket, gone, None if unbounded_wait else self.queue.max_wait_s)
            waited_s = 0.0 if unbounded_wait else time.monotonic() - enqueued
            return await self._work(ticket, work, Job(self._timeout_s - waited_s, self.map))
        finally:
            gone.cancel()

    async def _until_begun(
        self, ticket: Ticket, gone: asyncio.Future[None], max_wait_s: float | None
    ) -> None:
        """Wait until a frame may begin; if it may not, release its ticket and raise the error."""
        try:
            both = (ticket.begun, gone)
            await asyncio.wait(both, timeout=max_wait_s, return_when=asyncio.FIRST_COMPLETED)
            if not ticket.begun.done():
                raise ClientGoneError if gone.done() else self.queue.expire(ticket)
            if (make_error := ticket.begun.result()) is not None:
                raise make_error()
        except BaseException:
            self.queue.release(ticket)
            raise

    async def _work(self, ticket: Ticket, work: Callable[[Job], T], job: Job) -> T:
        """Work on a begun frame; its ticket is released once the thread is free."""
        done = asyncio.wrap_future(self._begin(ticket, work, job))
        try:
            return await done
        finally:
            job.cancel()
            # Otherwise the error would keep the future, the future the error, and both the frame.
            del done

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Call a function with each part of a frame and return the results in order.

        The calling thread works on the parts that no helper has taken. If it fails, no further part
        begins; the first error, in the order of the parts, is raised once no thread works on any.
        """
        parts = list(items)
        if len(parts) < 2 or max(1, self.queue.working) >= self.queue.threads:
            return [function(part) for part in parts]
        # Each call needs a context of its own: a context cannot be entered twice at once.
        futures = [self._helpers.submit(copy_context().run, function, part) for part in parts]
        try:
            own = {
                number: function(part)
                for number, part in enumerate(parts)
                if futures[number].cancel()
            }
            return [
                own[number] if number in own else future.result()
                for number, future in enumerate(futures)
            ]
        finally:
            wait([future for future in futures if not future.cancel()])
            # Otherwise an error would keep the futures, they the error, and both the frame.
            futures.clear()

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Call a function that does no work on a frame, such as loading the index."""
        return self._helpers.submit(function)

    def shut_down(self) -> None:
        self.queue.close()
        for job in tuple(self._jobs):
            job.cancel()
        self._threads.shutdown(cancel_futures=True)
        self._helpers.shutdown(cancel_futures=True)

    def _begin(self, ticket: Ticket, work: Callable[[Job], T], job: Job) -> Future[T]:
        loop, context = asyncio.get_running_loop(), copy_context()
        future = self._threads.submit(context.run, work, job)
        self._jobs.add(job)

        def end(future: Future[T]) -> None:
            self._jobs.discard(job)
            worked = not future.cancelled() and future.exception() is None
            with suppress(RuntimeError):  # The loop has ended.
                loop.call_soon_threadsafe(partial(self.queue.release, ticket, worked=worked))

        future.add_done_callback(end)
        return future
