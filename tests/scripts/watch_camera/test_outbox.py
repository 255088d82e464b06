"""The queue of events: nothing lost, nothing twice, in order."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scripts.watch_camera import outbox as module
from scripts.watch_camera.outbox import DeliveryError, Message, Outbox, RefusalError, deliver


def message(number: int) -> Message:
    return {"id": str(number), "event": "fell"}


@given(
    numbers=st.lists(st.integers(0, 20), max_size=30),
    failures=st.lists(st.sampled_from([DeliveryError, None, RefusalError]), max_size=30),
)
def test_each_message_is_taken_once_and_in_order(
    numbers: list[int], failures: list[type[Exception] | None]
) -> None:
    outbox, stopping, taken, refused = Outbox(), threading.Event(), [], set[str]()
    for number in numbers:
        outbox.put(["webhook", "nobody"], message(number))
    planned = iter(failures)

    def send(sent: Message) -> None:
        failure = next(planned, None)
        if failure is RefusalError:
            refused.add(sent["id"])
        if failure is not None:
            raise failure("no")
        taken.append(sent["id"])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "RETRY_AFTER_S", (0.0,))
        thread = threading.Thread(target=deliver, args=(outbox, "webhook", send, stopping))
        thread.start()
        unique = [str(number) for number in dict.fromkeys(numbers)]
        while outbox.wait_for_next("webhook", 0.0):
            stopping.wait(0.001)
        stopping.set()
        thread.join()
    assert taken == [name for name in unique if name not in refused]
    assert len(outbox) == len(unique)  # Those of nobody wait.


def test_a_file_keeps_what_waits(tmp_path: Path) -> None:
    path = tmp_path / "queue.db"
    Outbox(path).put(["webhook"], message(1))
    number, waiting = Outbox(path).wait_for_next("webhook", 0.0) or (0, {})
    assert waiting == message(1)
    Outbox(path).remove(number)
    assert not len(Outbox(path))
    assert Outbox(path).wait_until_empty(0.0)


def test_the_oldest_goes_where_too_many_wait(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", 2)
    outbox = Outbox()
    for number in range(3):
        outbox.put(["webhook"], message(number))
    assert len(outbox) == 2
    assert (outbox.wait_for_next("webhook", 0.0) or (0, {}))[1] == message(1)
    assert "oldest event is dropped" in capsys.readouterr().err
