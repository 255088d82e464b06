"""Threads: every task once, no more at a time than asked for."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from index.build.workers import Threads, bounded_map


@pytest.mark.parametrize("count", [0, 1, 7, 200])
def test_every_task_once(count: int) -> None:
    assert sorted(Threads().map(lambda task: task * task, range(count))) == [
        number * number for number in range(count)
    ]


def test_takes_tasks_only_as_they_are_worked_on() -> None:
    taken = 0
    done = threading.Semaphore(0)

    def tasks() -> Iterator[int]:
        nonlocal taken
        for number in range(20):
            taken += 1
            yield number

    def perform(task: int) -> int:
        assert done.acquire(timeout=10)
        return task

    with ThreadPoolExecutor(2) as pool:
        results = bounded_map(pool, perform, tasks(), lambda: 3)
        for finished in range(20):
            done.release()
            next(results)
            assert taken <= finished + 3 + 1
    assert taken == 20


def test_waits_until_there_are_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("index.build.workers.CHECK_S", 0.01)
    asked = iter([0, 0, 0, *[2] * 20])
    with ThreadPoolExecutor(2) as pool:
        assert sorted(bounded_map(pool, abs, [-1, -2, -3], lambda: next(asked))) == [1, 2, 3]


def test_an_error_ends_the_work() -> None:
    performed: list[int] = []

    def perform(task: int) -> None:
        performed.append(task)
        if task == 0:
            raise OSError("the disk is full")
        time.sleep(0.01)

    with ThreadPoolExecutor(1) as pool, pytest.raises(OSError, match="disk is full"):
        list(bounded_map(pool, perform, range(100), lambda: 4))
    assert len(performed) < 10
