"""What make bench asks and writes; nothing here is timed."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scripts.load.bench import camera_calls, interleaved, read_street
from scripts.load.client import Call


def test_tasks_take_turns_round_by_round() -> None:
    done: list[str] = []
    tasks = {name: lambda name=name: done.append(name) for name in "ab"}
    times = interleaved(tasks, rounds=2, repeats=3)
    assert "".join(done) == "aaabbb" * 2
    assert {name: len(one) for name, one in times.items()} == {"a": 6, "b": 6}


def test_a_film_goes_back_and_forth_and_its_time_on() -> None:
    film = [np.full((24, 32, 3), level, np.uint8) for level in (50, 100, 150, 200)]
    calls = camera_calls("yard", film)
    assert {call.path for call in calls} == {"/cameras/yard/frames"}
    times = [float(call.parts["timestamp"]) for call in calls]
    np.testing.assert_allclose(np.diff(times), 0.1)
    order = [film_number(call, film) for call in calls[:8]]
    assert order == [0, 1, 2, 3, 2, 1, 0, 1]


def film_number(call: Call, film: list[NDArray[np.uint8]]) -> int:
    frame = cv2.imdecode(np.frombuffer(call.parts["frame"], np.uint8), cv2.IMREAD_COLOR)
    return int(np.argmin([abs(int(frame.mean()) - int(one.mean())) for one in film]))


def test_without_the_video_it_says_what_is_left_out(tmp_path: Path) -> None:
    street, why = read_street(tmp_path)
    assert street is None
    assert "expected a video" in why[0]
