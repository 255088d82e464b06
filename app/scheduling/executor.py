"""The threads on which all work on images is done, in two roles.

Frames (:meth:`Executor.run`)
    Whole requests: a bounded number at once, the others in :class:`app.scheduling.queue.Line`.
    A frame has a deadline and is dropped when its client hangs up.
Parts (:meth:`Executor.map`)
    The people of a frame, or its images. The frame's own thread works through its parts. While
    there are fewer frames than may be worked on at once, other threads help, one part at a time,
    with the frames in turn. A new frame never waits for them: it has a thread of its own, and they
    take no further part while it is worked on.

A frame must not start frames, nor a part parts: both would wait for threads that may never be free.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Hashable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from contextvars import ContextVar, copy_context
from functools import partial
from typing import Any, Generic, Literal, TypeVar

from app.scheduling.job import ClientGoneError, Job
from app.scheduling.process import lower_thread_priority, trim_heap
from app.scheduling.queue import Line, Sender, Turn

T = TypeVar("T")
Item = TypeVar("Item")
Result = TypeVar("Result")

_TRIM_AFTER_S = 0.05


_role: ContextVar[Literal["", "frame", "part"]] = ContextVar("role", default="")


class _Parts(Generic[Item, Result]):
    """The parts of one frame, each done by the thread that takes it.

    Parameters
    ----------
    function : callable
    items : sequence
    """

    def __init__(self, function: Callable[[Item], Result], items: Iterable[Item]) -> None:
        self._function = function
        self._context = copy_context()
        self._left = deque((item, Future[Result]()) for item in items)
        self._futures = [future for _, future in self._left]

    def __len__(self) -> int:
        return len(self._left)

    def take(self) -> Callable[[], None] | None:
        """Return the work on the next part, None if all have been taken."""
        try:
            return partial(self._do, *self._left.popleft())
        except IndexError:
            return None

    def results(self) -> list[Result]:
        """Wait for the parts that other threads have taken; raise the first error."""
        wait(self._futures)
        try:
            return list(map(Future.result, self._futures))
        finally:
            # Else the error would keep the futures, they the error, and both of them the frame;
            # so would a variable that refers to one of them.
            self._futures.clear()

    def _do(self, item: Item, future: Future[Result]) -> None:
        try:
            # Each thread needs a copy: a context cannot be entered twice at once.
            result = self._context.copy().run(self._as_part, item)
        except BaseException as error:
            future.set_exception(error)
            while self._left:
                self._left.popleft()[1].set_exception(error)
            del future
        else:
            future.set_result(result)

    def _as_part(self, item: Item) -> Result:
        _role.set("part")
        return self._function(item)


class Executor:
    """A bounded number of frames at once, the others in a line; threads start when needed.

    Parameters
    ----------
    frames : int
        Worked on at once.
    max_wait_s : float
        For a frame, until its work begins.
    timeout_s : float
        For a frame, waiting included.
    """

    def __init__(self, frames: int, max_wait_s: float, timeout_s: float) -> None:
        self.line = Line(frames, min(max_wait_s, timeout_s))
        self._timeout_s = timeout_s
        # Helpers finish their parts beside new frames.
        self._threads = ThreadPoolExecutor(
            2 * frames - 1, thread_name_prefix="work", initializer=lower_thread_priority
        )
        self._jobs: set[Job] = set()
        self._lock = threading.Lock()
        self._helping = 0
        self._divided: deque[_Parts[Any, Any]] = deque()

    async def run(
        self,
        work: Callable[[Job], T],
        until_gone: Callable[[], Coroutine[None, None, None]],
        *,
        sender: Sender,
        kind: Hashable = None,
        camera: Hashable = None,
        patient: bool = False,
    ) -> T:
        """Work on a frame in a thread.

        Parameters
        ----------
        work : callable
            Calls :meth:`Job.checkpoint` between its steps.
        until_gone : async callable
            Returns when the client has hung up. A frame that waits is then dropped, the work on
            one that has begun is cancelled.
        sender, kind, camera, patient
            See :meth:`app.scheduling.queue.Line.join`.

        Raises
        ------
        OverloadedError, DeadlineError, SupersededError, ClientGoneError
        RuntimeError
            If it is called by work on a frame.
        """
        if _role.get():
            raise RuntimeError("expected a frame to be started by a request, not by another frame")
        joined = time.monotonic()
        turn = self.line.join(sender, kind, camera, patient=patient)
        gone = asyncio.ensure_future(until_gone())
        try:
            longest_s = None if patient else self.line.max_wait_s
            await _first_of(turn.begun, gone, longest_s)
            if not turn.begun.done():
                raise ClientGoneError if gone.done() else self.line.give_up(turn)
            if (refused := turn.begun.result()) is not None:
                raise refused()
        except BaseException:
            gone.cancel()
            self.line.leave(turn)
            raise
        waited_s = 0.0 if patient else time.monotonic() - joined
        job = Job(self._timeout_s - waited_s, self.map)
        done = asyncio.wrap_future(self._begin(turn, work, job))
        try:
            await _first_of(done, gone)
            if not done.done():
                job.cancel()
            # Cancelled or not, it takes a thread until it ends.
            return await done
        finally:
            job.cancel()
            gone.cancel()
            # Else the error would keep the future, it the error, and both of them the frame.
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
        helpers = min(len(parts), self.line.threads) - 1
        if helpers > 0:
            with self._lock:
                self._divided.append(parts)
            for _ in range(helpers):
                self._threads.submit(self._help)
        while (part := parts.take()) is not None:
            part()
        return parts.results()

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Call a function that is no work on a frame, such as loading what frames need."""
        return self._threads.submit(function)

    def shut_down(self) -> None:
        """Cancel what is left, and wait for the threads to end."""
        self.line.close()
        for job in tuple(self._jobs):
            job.cancel()
        self._threads.shutdown(cancel_futures=True)

    def _begin(self, turn: Turn, work: Callable[[Job], T], job: Job) -> Future[T]:
        """Work on the frame whose turn has come; it leaves the line once its thread is free."""
        loop, context = asyncio.get_running_loop(), copy_context()
        future = self._threads.submit(context.run, self._as_frame, work, job)
        self._jobs.add(job)

        def end(future: Future[T]) -> None:
            self._jobs.discard(job)
            worked = not future.cancelled() and future.exception() is None
            with suppress(RuntimeError):  # The loop has ended.
                loop.call_soon_threadsafe(self._end, turn, worked)

        future.add_done_callback(end)
        return future

    def _end(self, turn: Turn, worked: bool) -> None:
        self.line.leave(turn, worked=worked)
        if self._divided:
            with suppress(RuntimeError):  # The threads are being shut down.
                self._threads.submit(self._help)

    def _help(self) -> None:
        """Work on parts of other frames while there are fewer frames than threads for them."""
        while (part := self._next_part()) is not None:
            part()
            with self._lock:
                self._helping -= 1

    def _next_part(self) -> Callable[[], None] | None:
        """Return the work on a part of the frame whose turn it is."""
        with self._lock:
            while self._divided and self.line.working + self._helping < self.line.threads:
                parts = self._divided.popleft()
                if (part := parts.take()) is not None:
                    self._divided.append(parts)
                    self._helping += 1
                    return part
        return None

    def _as_frame(self, work: Callable[[Job], T], job: Job) -> T:
        _role.set("frame")
        started = time.monotonic()
        try:
            return work(job)
        finally:
            # What took long took much memory, some ten megabytes of which stay behind.
            if time.monotonic() - started > _TRIM_AFTER_S:
                trim_heap()


async def _first_of(
    one: asyncio.Future[Any], other: asyncio.Future[Any], timeout_s: float | None = None
) -> None:
    await asyncio.wait((one, other), timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
