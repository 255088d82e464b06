"""The soak: its late frames are late, and what it measures is judged."""

from fastapi.testclient import TestClient

from index.store import PoseIndex
from scripts.load.client import Answer, Request, Tally
from scripts.load.soak import MAIN, criteria, figures, kinds


def test_late_frames_are_late(client: TestClient, tiny_index: PoseIndex) -> None:
    (call,) = kinds(tiny_index)["camera_late_frame"].calls
    body, headers = call.message
    statuses = [client.post(call.path, content=body, headers=headers).status_code for _ in range(3)]
    assert statuses == [200, 409, 409]


def test_slower_answers_and_more_memory_fail(tiny_index: PoseIndex) -> None:
    call = kinds(tiny_index)[MAIN].calls[0]
    answers = [Answer(Request(call, MAIN, n), 200, 10.0 + n, None) for n in range(1, 101)]
    memory = [(n, 100.0 + n) for n in range(5, 101, 5)]
    found = figures(Tally(answers, seconds=1.0), memory, 100)
    assert found["memory_mb"] == {"early": 117.5, "late": 190.0}
    assert list(criteria(found).values()) == [True, True, False, False]
