"""Copies of what serves one call at a time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import count
from time import sleep

import pytest

from app.vision.runtime.copies import Copies


def test_one_after_the_other_use_the_same_copy() -> None:
    copies = Copies(count().__next__)
    seen = []
    for _ in range(3):
        with copies.one() as copy:
            seen.append(copy)
    assert seen == [0, 0, 0]


def test_at_once_each_has_its_own() -> None:
    copies = Copies(count().__next__)
    with copies.one() as first, copies.one() as second:
        assert first != second
    with copies.one() as again, copies.one() as other:
        assert {again, other} == {first, second}


def test_there_are_no_more_than_wanted() -> None:
    copies = Copies(count().__next__, 2)
    inside, seen = [0], []

    def use(_: int) -> None:
        with copies.one() as copy:
            inside[0] += 1
            seen.append((copy, inside[0]))
            sleep(0.001)
            inside[0] -= 1

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(use, range(30)))
    assert {copy for copy, _ in seen} <= {0, 1}
    assert max(at_once for _, at_once in seen) <= 2


def test_where_one_failed_another_is_had() -> None:
    copies = Copies(count().__next__, 1)
    for _ in range(3):
        with pytest.raises(ZeroDivisionError), copies.one():
            _ = 1 // 0


def test_a_copy_that_failed_is_not_used_again() -> None:
    copies = Copies(count().__next__)
    with pytest.raises(ZeroDivisionError), copies.one():
        _ = 1 // 0
    with copies.one() as next_one:
        assert next_one == 1
