"""A circuit breaker: what does not answer is not asked again by every request."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from index.neighbours import FailureReason, Neighbours, UnavailableError

log = logging.getLogger("app")

OPEN_AFTER = 3
"""Failures in a row after which the breaker opens."""


class CircuitBreaker:
    """Open after several failures in a row, closed again by the first success.

    Parameters
    ----------
    on_failure : callable
        Called with the reason of every failure.
    open_after : int
        Failures in a row.
    """

    def __init__(
        self,
        on_failure: Callable[[FailureReason], object] = lambda reason: None,
        open_after: int = OPEN_AFTER,
    ) -> None:
        self._on_failure = on_failure
        self._open_after = open_after
        self._failures = 0
        self._last: UnavailableError | None = None
        self._lock = threading.Lock()

    @property
    def is_open(self) -> bool:
        """Whether requests are refused at once."""
        return self._failures >= self._open_after

    def check(self) -> None:
        """Raise the last failure if it is open."""
        last = self._last
        if self.is_open and last is not None:
            raise UnavailableError(str(last), last.reason)

    def failed(self, error: UnavailableError) -> None:
        """Count a failure."""
        self._on_failure(error.reason)
        with self._lock:
            self._failures += 1
            # Without its traceback, which would keep the frame that was being searched for.
            self._last = UnavailableError(str(error), error.reason)
            opens = self._failures == self._open_after
        if opens:
            log.error("searches are refused until one succeeds: %s", error)

    def succeeded(self) -> None:
        """Note a success."""
        if not self._failures:
            return
        with self._lock:
            closes, self._failures, self._last = self.is_open, 0, None
        if closes:
            log.info("searches succeed again")


class GuardedNeighbours:
    """A search behind a circuit breaker; see :class:`index.neighbours.Neighbours`.

    Parameters
    ----------
    neighbours : Neighbours
    breaker : CircuitBreaker
    """

    def __init__(self, neighbours: Neighbours, breaker: CircuitBreaker) -> None:
        self._neighbours = neighbours
        self._breaker = breaker

    def __len__(self) -> int:
        return len(self._neighbours)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Search, unless the breaker is open."""
        self._breaker.check()
        return self.search_anyway(queries, k)

    def search_anyway(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Search, and have the breaker note the outcome."""
        try:
            found = self._neighbours.search(queries, k)
        except UnavailableError as error:
            self._breaker.failed(error)
            raise
        self._breaker.succeeded()
        return found
