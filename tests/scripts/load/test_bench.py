"""What make bench asks and writes; nothing here is timed."""

import itertools
from functools import partial

from scripts.load.bench import interleaved, summary


def test_tasks_take_turns_round_by_round() -> None:
    done: list[str] = []
    spent = itertools.count()
    tasks = {name: (partial(done.append, name), lambda: next(spent)) for name in "ab"}
    times = interleaved(tasks, rounds=2, repeats=3)
    assert "".join(done) == "aaabbb" * 2
    assert {name: len(one) for name, one in times.items()} == {"a": 6, "b": 6}
    assert {core_ms for one in times.values() for _, core_ms in one} == {1000}


def test_figures_a_person_need_people() -> None:
    times = [(10.0, 30.0), (20.0, 30.0), (90.0, 60.0)]
    found = summary(times, [2, 3])
    assert (found["median_ms"], found["core_ms"]) == (20, 40)
    assert (found["median_ms_a_person"], found["core_ms_a_person"]) == (8, 16)
    assert "core_ms_a_person" not in summary(times, [0])
