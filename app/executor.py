"""The threads on which all work on images is done, in two roles.

Frames (:meth:`Executor.run`)
    Whole requests: a bounded number at once, and a bounded queue before them. A frame has a
    deadline and is dropped when its client hangs up. A frame of a live camera that still waits is
    replaced by the next one of the same camera: a late answer is worth less than one to a newer
    frame. At most half of the frames worked on at once are photographs in which people have to be
    found: each keeps two cores busy, and two on two cores are both answered later. Frames of one
    camera session are worked on one after the other.
Parts (:meth:`Executor.map`)
    The people of a frame, or its images. The frame's own thread works through its parts. While
    there are fewer frames than may be worked on at once, other threads help, one part at a time,
    with the frames in turn. A new frame never waits for them: it has a thread of its own, and they
    take no further part while it is worked on.

A frame must not start frames, nor a part parts: both would wait for threads that may never be free.
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
from contextvars import Context, ContextVar, copy_context
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, Literal, Protocol, TypeVar

from app.cancellation import BusyError, CancellationToken, ClientGoneError, DeadlineError
from app.process import lower_thread_priority, trim_heap

T = TypeVar("T")
Item = TypeVar("Item")
Result = TypeVar("Result")

FULL = "the service is working to capacity; try again shortly"
_SUPERSEDED = "a newer frame of this camera has taken the place of this one, which still waited"
_BUSY = "the service was too busy to answer in time; try again shortly"
_TRIM_AFTER_S = 0.05
# Weight of the newest duration in the running mean.
_NEWEST_WEIGHT = 0.2


class Map(Protocol):
    """Calls a function with each part of a frame and returns the results in order."""

    def __call__(
        self, function: Callable[[Item], Result], items: Iterable[Item], /
    ) -> list[Result]:
        """Call it."""
        ...


def map_serially(function: Callable[[Item], Result], items: Iterable[Item], /) -> list[Result]:
    """Call a function with one part after the other, where there is no executor."""
    return [function(item) for item in items]


_role: ContextVar[Literal["", "frame", "part"]] = ContextVar("role", default="")


class OverloadedError(BusyError):
    """The queue is full."""

    reason = "queue_full"


class SupersededError(BusyError):
    """A newer frame of the same camera has taken the place of this one."""

    reason = "superseded"


@dataclass(eq=False)
class _Job:
    """Work on a frame, its cancellation, the request's context, and its result."""

    work: Callable[[CancellationToken], Any]
    token: CancellationToken
    photograph: bool
    session: Hashable = None
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
        """Return the job that has its turn, None if its client no longer waits."""
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
    """A bounded number of frames at once, with a bounded queue; threads start when needed.

    Parameters
    ----------
    frames : int
        Worked on at once.
    queue_length : int
        Frames that may wait; one more is refused at once.
    timeout_s : float
        For a frame, waiting included.
    """

    def __init__(self, frames: int, queue_length: int, timeout_s: float) -> None:
        self._frames = frames
        # Helpers finish their parts beside new frames.
        self._threads = ThreadPoolExecutor(
            2 * frames - 1, thread_name_prefix="work", initializer=lower_thread_priority
        )
        self._capacity = frames + queue_length
        self._timeout_s = timeout_s
        self._mean_s = 0.0
        self._places: set[_Place] = set()
        self._newest: dict[Hashable, _Place] = {}
        self._lock = threading.Lock()
        self._running = self._helping = self._photographs = 0
        self._sessions: set[Hashable] = set()
        self._waiting: deque[_Place] = deque()
        self._divided: deque[_Parts[Any, Any]] = deque()

    @property
    def inside(self) -> int:
        """Frames that are worked on or wait."""
        return len(self._places)

    @property
    def capacity(self) -> int:
        """Frames that may be worked on or wait at once."""
        return self._capacity

    def is_full(self, camera: Hashable = None) -> bool:
        """Whether another frame, of this camera if it is of one, would be refused."""
        if self.inside < self._capacity:
            return False
        newest = self._newest.get(camera)
        return newest is None or not newest.is_replaceable()

    def retry_after_s(self) -> int:
        """Seconds until the frames inside are probably done, at least 1, at most the timeout."""
        needed_s = self.inside * self._mean_s / self._frames
        return max(1, math.ceil(min(needed_s, self._timeout_s)))

    async def run(
        self,
        work: Callable[[CancellationToken], T],
        until_gone: Callable[[], Coroutine[None, None, None]],
        camera: Hashable = None,
        *,
        photograph: bool = False,
        session: Hashable = None,
    ) -> T:
        """Work on a frame in a thread.

        Parameters
        ----------
        work : callable
            Calls :meth:`CancellationToken.check` between its steps.
        until_gone : async callable
            Returns when the client has hung up. A frame that waits is then dropped, the work on
            one that has begun is cancelled.
        camera : hashable, optional
            A live camera: its frame that still waits is superseded.
        photograph : bool
            Whether people have to be found in it. Each keeps two cores busy, so at most half of the
            frames worked on at once are photographs; silhouettes overtake those that wait.
        session : hashable, optional
            A camera session: its frames are worked on one at a time, in order of arrival.

        Raises
        ------
        OverloadedError, DeadlineError, SupersededError, ClientGoneError
        RuntimeError
            If it is called by work on a frame.
        """
        if _role.get():
            raise RuntimeError("expected a frame to be started by a request, not by another frame")
        job = _Job(work, CancellationToken(self._timeout_s), photograph, session)
        place = self._place(job, camera)
        done: asyncio.Future[T] = asyncio.wrap_future(job.future)
        gone = asyncio.ensure_future(until_gone())
        try:
            await asyncio.wait(
                (done, gone), timeout=self._timeout_s, return_when=asyncio.FIRST_COMPLETED
            )
            if gone.done():
                job.token.cancel()
            if job.future.cancel():  # It still waited.
                raise ClientGoneError if gone.done() else DeadlineError(_BUSY)
            # Cancelled or not, it takes a thread until it ends.
            return await done
        finally:
            job.token.cancel()
            done.cancel()
            gone.cancel()
            if place.job is job:
                self._leave(place, camera)

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
        helpers = min(len(parts), self._frames) - 1
        if helpers > 0:
            with self._lock:
                self._divided.append(parts)
            for _ in range(helpers):
                self._threads.submit(self._work)
        while (part := parts.take()) is not None:
            part()
        return parts.results()

    def submit(self, function: Callable[[], T]) -> Future[T]:
        """Call a function that is no work on a frame, such as loading what frames need."""
        return self._threads.submit(function)

    def shut_down(self) -> None:
        """Cancel what is left, and wait for the threads to end."""
        for place in tuple(self._places):
            place.job.token.cancel()
            place.job.future.cancel()
        self._threads.shutdown(cancel_futures=True)

    def _place(self, job: _Job, camera: Hashable) -> _Place:
        """Return the job's place: that of the camera's last one if it still waits, else a new one.

        This way a camera keeps its turn, however often it sends.
        """
        newest = self._newest.get(camera)
        if newest is not None and newest.replace(job):
            return newest
        if self.inside >= self._capacity:
            raise OverloadedError(FULL)
        place = _Place(job)
        self._places.add(place)
        if camera is not None:
            self._newest[camera] = place
        with self._lock:
            self._waiting.append(place)
        self._threads.submit(self._work)
        return place

    def _leave(self, place: _Place, camera: Hashable) -> None:
        self._places.discard(place)
        if self._newest.get(camera) is place:
            del self._newest[camera]

    def _work(self) -> None:
        """Work until nothing is left to do."""
        while (task := self._next()) is not None:
            task()

    def _next(self) -> Callable[[], None] | None:
        """Return the work on a frame that waits, else on a part of the frame whose turn it is."""
        with self._lock:
            if self._running < self._frames and (place := self._next_place()) is not None:
                self._waiting.remove(place)
                photograph, session = place.job.photograph, place.job.session
                self._running += 1
                self._photographs += photograph
                if session is not None:
                    self._sessions.add(session)
                return partial(self._work_on, place, photograph, session)
            while self._divided and self._running + self._helping < self._frames:
                parts = self._divided.popleft()
                if (part := parts.take()) is not None:
                    self._divided.append(parts)
                    self._helping += 1
                    return partial(self._help, part)
        return None

    def _next_place(self) -> _Place | None:
        """Return the first place that waits and may be worked on beside the others."""
        full = self._photographs >= max(1, self._frames // 2)
        return next(
            (
                place
                for place in self._waiting
                if not (full and place.job.photograph) and place.job.session not in self._sessions
            ),
            None,
        )

    def _help(self, part: Callable[[], None]) -> None:
        part()
        with self._lock:
            self._helping -= 1

    def _work_on(self, place: _Place, photograph: bool, session: Hashable) -> None:
        try:
            self._do(place)
        finally:
            with self._lock:
                self._running -= 1
                self._photographs -= photograph
                self._sessions.discard(session)
            if self._waiting:
                # Two may have waited for this one: a photograph, and the session's next frame.
                with suppress(RuntimeError):  # The threads are being shut down.
                    self._threads.submit(self._work)

    def _do(self, place: _Place) -> None:
        job = place.begin()
        if job is None:
            return
        try:
            result = job.context.run(self._as_frame, job.work, job.token)
        except BaseException as error:
            job.future.set_exception(error)
            # Else the error would keep the job, the job the error, and both of them the frame.
            del job, place
        else:
            job.future.set_result(result)

    def _as_frame(self, work: Callable[[CancellationToken], T], token: CancellationToken) -> T:
        _role.set("frame")
        started = time.monotonic()
        try:
            return work(token)
        finally:
            took_s = time.monotonic() - started
            self._mean_s += _NEWEST_WEIGHT * (took_s - self._mean_s)
            # What took long took much memory, some ten megabytes of which stay behind.
            if took_s > _TRIM_AFTER_S:
                trim_heap()
