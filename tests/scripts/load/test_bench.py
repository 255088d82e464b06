"""What make bench asks and writes; nothing here is timed."""

from scripts.load.bench import summary


def test_figures_a_person_need_people() -> None:
    times = [(10.0, 30.0), (20.0, 30.0), (90.0, 60.0)]
    found = summary(times, [2, 3])
    assert (found["median_ms"], found["core_ms"]) == (20, 40)
    assert (found["median_ms_a_person"], found["core_ms_a_person"]) == (8, 16)
    assert "core_ms_a_person" not in summary(times, [0])
