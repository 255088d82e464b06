"""What make bench asks and writes; nothing here is timed."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from scripts.load.bench import camera_calls, interleaved, read_street, sender, without_people
from scripts.load.client import Call, Client


def test_tasks_take_turns_round_by_round() -> None:
    done: list[str] = []
    tasks = {name: lambda name=name: done.append(name) for name in "ab"}
    times = interleaved(tasks, rounds=2, repeats=3)
    assert "".join(done) == "aaabbb" * 2
    assert {name: len(one) for name, one in times.items()} == {"a": 6, "b": 6}


def test_people_who_walk_by_are_not_in_the_scene() -> None:
    frames = [np.full((576, 768, 3), 100, np.uint8) for _ in range(5)]
    for number, frame in enumerate(frames):
        frame[200:400, 100 * number : 100 * number + 60] = 20
    scene = without_people(frames)
    assert scene.shape == (480, 640, 3)
    assert (scene == 100).all()


def test_calls_go_round_and_a_refusal_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[str] = []

    def answer(_: Client, call: Call) -> tuple[int, bytes]:
        sent.append(call.path)
        return (422, b"no such thing") if len(sent) > 3 else (200, b"{}")

    monkeypatch.setattr(Client, "send", answer)
    send = sender(Client("http://127.0.0.1:1"), [Call("GET", "/a"), Call("GET", "/b")])
    for _ in range(3):
        send()
    assert sent == ["/a", "/b", "/a"]
    with pytest.raises(ValueError, match="got 422: no such thing"):
        send()


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
