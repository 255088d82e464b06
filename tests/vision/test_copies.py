"""Copies of what serves one call at a time."""

from __future__ import annotations

from itertools import count

import pytest

from app.vision.copies import Copies


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


def test_a_copy_that_failed_is_not_used_again() -> None:
    copies = Copies(count().__next__)
    with pytest.raises(ZeroDivisionError), copies.one():
        _ = 1 // 0
    with copies.one() as next_one:
        assert next_one == 1
