"""Pictures divided among threads."""

from __future__ import annotations

import threading

import pytest

from app.workers import Workers


@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_the_order_of_the_items(threads: int) -> None:
    assert Workers(threads).map(lambda item: item**2, range(20)) == [i**2 for i in range(20)]
    assert Workers(threads).map(str, []) == []


def test_one_thread_is_the_callers_own() -> None:
    assert Workers(1).map(lambda _: threading.current_thread(), "ab") == (
        [threading.current_thread()] * 2
    )


def test_one_item_is_worked_on_by_the_same_threads_as_several() -> None:
    workers = Workers(2)
    used = {workers.map(lambda _: threading.get_ident(), "a")[0] for _ in range(20)}
    assert threading.get_ident() not in used and len(used) <= 2


def test_several_items_are_worked_on_at_once() -> None:
    meeting = threading.Barrier(3, timeout=10)
    # Each waits for the others: one after the other they would wait in vain.
    assert sorted(Workers(3).map(lambda _: meeting.wait(), range(3))) == [0, 1, 2]


@pytest.mark.parametrize("threads", [1, 2])
def test_the_first_failure_reaches_the_caller(threads: int) -> None:
    with pytest.raises(ZeroDivisionError):
        Workers(threads).map(lambda item: 1 // item, [1, 0, 2])
