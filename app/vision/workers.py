"""Threads among which the pictures and the people of a frame are divided.

OpenCV's own threads divide each layer of a network, and wait for one another after each. Where
there are several pictures to look at, a thread that takes one after the other from start to end
does nearly twice as many in the same time. One picture is looked at here as well: however many
frames are worked on at once, no network is then needed in more copies than there are threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from app.process import give_way

Item = TypeVar("Item")
Result = TypeVar("Result")


class Workers:
    """So many threads; with one, the caller's own does the work.

    Parameters
    ----------
    threads : int
    """

    def __init__(self, threads: int = 1) -> None:
        self._threads = (
            ThreadPoolExecutor(threads, thread_name_prefix="pictures", initializer=give_way)
            if threads > 1
            else None
        )

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Call a function with each item and return what it gives, in order.

        The function must not call this again: all threads may wait for one that is never free.
        """
        if self._threads is None:
            return [function(item) for item in items]
        return list(self._threads.map(function, items))
