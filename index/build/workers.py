"""Who does the work of a build: threads of this process, or others behind the same interface."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from time import sleep
from typing import Any, Protocol, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

_END: Any = object()

CHECK_S = 1.0
"""How often those who wait look whether anybody works."""


class WorkersError(RuntimeError):
    """Workers who cannot be worked with; the message is one sentence."""


class Workers(Protocol):
    """Whoever performs tasks."""

    def map(self, perform: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Perform tasks; results come as they are ready, in any order.

        Tasks are taken from the iterable only as they are worked on.
        """


class Threads:
    """As many threads of this process as it has cores."""

    def map(self, perform: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Perform tasks; see :class:`Workers`."""
        cores = os.cpu_count() or 1
        with ThreadPoolExecutor(cores) as pool:
            yield from bounded_map(pool, perform, tasks, lambda: 2 * cores)


def bounded_map(
    executor: Executor,
    perform: Callable[[Task], Result],
    tasks: Iterable[Task],
    at_once: Callable[[], int],
) -> Iterator[Result]:
    """Perform tasks, of which no more than ``at_once()`` are handed out at a time.

    Parameters
    ----------
    executor : Executor
    perform : callable
    tasks : iterable
    at_once : callable
        Asked at least every :data:`CHECK_S` seconds; an exception from it ends the work.
    """
    left = iter(tasks)
    task = next(left, _END)
    waiting: set[Future[Result]] = set()
    try:
        while waiting or task is not _END:
            free = at_once() - len(waiting)
            while free > 0 and task is not _END:
                waiting.add(executor.submit(perform, task))
                task, free = next(left, _END), free - 1
            if not waiting:
                sleep(CHECK_S)
                continue
            done, waiting = wait(waiting, timeout=CHECK_S, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        for future in waiting:
            future.cancel()
