"""What make bench asks and writes; nothing here is timed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.vision.people import Box
from scripts.load.benchmark import interleaved, read_street, sender
from scripts.load.benchmark_cases import Street, without_people
from scripts.load.client import Call, Client

BOX = Box(40, 20, 30, 90)


@pytest.fixture
def street() -> Street:
    """Two plain frames; one box in the first."""
    busy = tuple(np.full((144, 192, 3), grey, np.uint8) for grey in (90, 160))
    return Street(busy, np.full((480, 640, 3), 120, np.uint8), BOX)


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
    with pytest.raises(RuntimeError, match="got 422: no such thing"):
        send()


def test_without_the_video_it_says_what_is_left_out(tmp_path: Path) -> None:
    street, why = read_street(tmp_path)
    assert street is None
    assert "expected a video" in why[0]
