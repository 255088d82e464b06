"""The queue of events: nothing lost, nothing twice, in order."""

import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import app.bridge as common
from app.bridge import RefusedError, UnavailableError, outbox
from app.bridge.outbox import Message, Outbox, deliver
from tests.app.bridge.servers import full_disk


def message(number: int, camera: str = "yard") -> Message:
    return {"id": str(number), "camera_id": camera, "event": "fell"}


def first(waiting: Outbox, receiver: str = "webhook") -> Message | None:
    return waiting.wait_for_next(receiver, 0.0)


@given(
    numbers=st.lists(st.integers(0, 20), max_size=30),
    failures=st.lists(
        st.sampled_from([UnavailableError("no"), None, RefusedError("no", 422)]), max_size=30
    ),
)
def test_each_message_is_taken_once_and_in_order(
    numbers: list[int], failures: list[Exception | None]
) -> None:
    waiting, stopping = Outbox("yard", ["webhook", "nobody"]), threading.Event()
    taken, refused = list[str](), set[str]()
    for number in numbers:
        waiting.put(message(number))
    planned = iter(failures)

    def send(sent: Message) -> None:
        failure = next(planned, None)
        if isinstance(failure, RefusedError):
            refused.add(sent["id"])
        if failure is not None:
            raise failure
        taken.append(sent["id"])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(common, "WAITS_S", (0.0,))
        patch.setattr(outbox, "_POLL_S", 0.001)
        thread = threading.Thread(target=deliver, args=(waiting, stopping, "webhook", send))
        thread.start()
        unique = [str(number) for number in dict.fromkeys(numbers)]
        while first(waiting):
            stopping.wait(0.001)
        stopping.set()
        thread.join()
    assert taken == [name for name in unique if name not in refused]
    assert len(waiting) == len(unique)  # Those of nobody wait.


def test_a_file_keeps_what_waits(tmp_path: Path) -> None:
    """For each camera and receiver, even for one that is not there for now."""
    path, receivers = tmp_path / "queue.db", ["webhook", "mqtt"]
    yard, hall = Outbox("yard", receivers, path), Outbox("hall", receivers, path)
    for number in range(3):
        yard.put(message(number))
        hall.put(message(10 + number, "hall"))
    yard.remove("webhook", "0")
    hall.remove("mqtt", "10")
    assert len(Outbox("yard", ["webhook"], path)) == 2
    again = Outbox("yard", receivers, path)
    assert (first(again), first(again, "mqtt"), again.newest) == (message(1), message(0), "2")
    again = Outbox("hall", receivers, path)
    assert (len(again), again.newest) == (5, "12")
    assert Outbox("attic", receivers, path).newest is None


def test_what_a_full_disk_does_not_take_is_written_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "queue.db"
    waiting = Outbox("yard", ["webhook"], path)
    for number in range(3):
        waiting.put(message(number))
    with full_disk():
        waiting.remove("webhook", "0")
        waiting.put(message(3))
        waiting.put(message(4))
        waiting.remove("webhook", "1")
        assert (first(waiting), waiting.save()) == (message(2), False)
    waiting.put(message(5))
    assert waiting.save()
    again = Outbox("yard", ["webhook"], path)
    kept = []
    while (oldest := first(again)) is not None:
        kept.append(oldest)
        again.remove("webhook", oldest["id"])
    assert kept == [message(number) for number in (2, 3, 4, 5)]
    said = capsys.readouterr().err  # Also of the sources of other tests, which try again.
    assert said.count("queue: ") == 2  # When it begins, and when it ends.


def test_the_oldest_goes_where_too_many_wait(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(outbox, "MAX_WAITING", 2)
    waiting = Outbox("yard", ["webhook"])
    for number in range(3):
        waiting.put(message(number))
    assert len(waiting) == 2
    assert first(waiting) == message(1)
    assert "oldest event is dropped" in capsys.readouterr().err
