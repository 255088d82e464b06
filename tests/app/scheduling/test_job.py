"""Work on a frame whose time may be over before all of its people are done."""

import pytest

from app.scheduling.job import Job
from tests.support.jobs import LateJob


@pytest.mark.parametrize("in_time", range(5))
def test_where_some_suffice_the_best_are_done_in_time(in_time: int) -> None:
    job = LateJob(in_time)
    job.some_suffice = True
    done = job.map_until(0.5, lambda item: 10 * item, range(1, 5))
    first = min(1 + in_time, 4)
    assert done == [10, 20, 30, 40][:first] + [None] * (4 - first)
    assert job.left_out == 4 - first


def test_a_share_of_the_time_is_over_before_all_of_it() -> None:
    job = Job(0.0)
    assert not job.is_late(0.5)
    job.some_suffice = True
    assert job.is_late(0.5)
    early = Job(1e6)
    early.some_suffice = True
    assert not early.is_late(0.5)
