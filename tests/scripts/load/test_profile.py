"""What the profile counts; nothing here is timed."""

from __future__ import annotations

from app.scheduling.job import STAGES, Job, serial_map
from scripts.load.profile import TOTAL, profiled, table


def work(job: Job, _: int) -> None:
    with job.stage("search"):
        sum(range(200_000))


def test_stages_and_all_of_a_frame_are_counted() -> None:
    found = profiled(work, serial_map, 2)
    assert list(found) == [*STAGES, TOTAL]
    for stage in (*STAGES, TOTAL):
        assert all(
            (milliseconds > 0) == (stage in ("search", TOTAL)) for milliseconds in found[stage]
        )
    assert found["search"][1] <= found[TOTAL][1]


def test_the_share_of_the_cores_that_is_idle() -> None:
    rows = table({"a mask": {"decode": (0.0, 0.0), "search": (10.0, 15.0), TOTAL: (10.0, 25.0)}}, 2)
    assert [(row["stage"], row["idle"]) for row in rows] == [("search", 0.25), (TOTAL, 0.0)]
