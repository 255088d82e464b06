"""Threads among which the people of a frame are divided."""

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
            ThreadPoolExecutor(threads, thread_name_prefix="person", initializer=give_way)
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
