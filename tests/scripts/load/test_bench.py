"""What make bench asks and writes; nothing here is timed."""

from pathlib import Path

from scripts.load.bench import interleaved, read_street


def test_tasks_take_turns_round_by_round() -> None:
    done: list[str] = []
    tasks = {name: lambda name=name: done.append(name) for name in "ab"}
    times = interleaved(tasks, rounds=2, repeats=3)
    assert "".join(done) == "aaabbb" * 2
    assert {name: len(one) for name, one in times.items()} == {"a": 6, "b": 6}


def test_without_the_video_it_says_what_is_left_out(tmp_path: Path) -> None:
    street, why = read_street(tmp_path)
    assert street is None
    assert "expected a video" in why[0]
