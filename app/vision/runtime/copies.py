"""Copies of what serves one call at a time, so that several threads may use it at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from threading import Semaphore
from typing import Generic, TypeVar

T = TypeVar("T")


class Copies(Generic[T]):
    """As many copies as were ever in use at once; safe under several threads.

    Another is made only where a call comes while all are busy.

    Parameters
    ----------
    make : callable
        Makes a copy.
    most : int, optional
        So many, and no more: calls wait for one another. Else as many as are called for.
    """

    def __init__(self, make: Callable[[], T], most: int | None = None) -> None:
        self._make = make
        self._idle: deque[T] = deque()
        self._free = nullcontext() if most is None else Semaphore(most)

    @contextmanager
    def one(self) -> Iterator[T]:
        """Have a copy to oneself; one that failed is not used again."""
        with self._free:
            try:
                copy = self._idle.pop()
            except IndexError:
                copy = self._make()
            yield copy
            self._idle.append(copy)
