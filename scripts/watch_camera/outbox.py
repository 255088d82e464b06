"""Events that wait until each receiver has taken them, in a file or in memory."""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from scripts.watch_camera.common import say

Message = Mapping[str, Any]

RETRY_AFTER_S = (0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
MAX_WAITING = 100_000
"""For each receiver; beyond it the oldest are dropped."""

_SCHEMA = """
create table if not exists waiting (
    number integer primary key, receiver text, id text, message text, unique (receiver, id))
"""


class DeliveryError(Exception):
    """A receiver has not taken a message, and may take it later."""


class RefusalError(Exception):
    """A receiver will never take this message."""


class Outbox:
    """Messages in order, for several receivers; safe under several threads.

    Parameters
    ----------
    path : Path or None
        Keeps them beyond the end of the process; None for memory alone.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._database = sqlite3.connect(
            path or ":memory:", check_same_thread=False, isolation_level=None
        )
        self._database.execute(_SCHEMA)
        self._changed = threading.Condition()

    def __len__(self) -> int:
        with self._changed:
            count: int = self._database.execute("select count(*) from waiting").fetchone()[0]
            return count

    def put(self, receivers: Iterable[str], message: Message) -> None:
        """Add a message for each receiver, unless one with its ``id`` waits already."""
        with self._changed:
            self._database.execute("begin")
            for receiver in receivers:
                row = (receiver, message["id"], json.dumps(message))
                self._database.execute(
                    "insert or ignore into waiting (receiver, id, message) values (?, ?, ?)", row
                )
                dropped = self._database.execute(
                    "delete from waiting where number in (select number from waiting "
                    "where receiver = ? order by number desc limit -1 offset ?)",
                    (receiver, MAX_WAITING),
                )
                if dropped.rowcount:
                    say(f"{receiver} has not answered for too long: the oldest event is dropped")
            self._database.execute("commit")
            self._changed.notify_all()

    def wait_for_next(self, receiver: str, timeout_s: float) -> tuple[int, Message] | None:
        """Return number and content of a receiver's oldest message; None if there is none."""
        with self._changed:
            row = self._oldest(receiver)
            if row is None:
                self._changed.wait(timeout_s)
                row = self._oldest(receiver)
        return None if row is None else (row[0], json.loads(row[1]))

    def remove(self, number: int) -> None:
        """Remove a message that its receiver has taken."""
        with self._changed:
            self._database.execute("delete from waiting where number = ?", (number,))
            self._changed.notify_all()

    def wait_until_empty(self, timeout_s: float | None = None) -> bool:
        """Wait until all messages are taken; return whether they are."""
        with self._changed:
            return self._changed.wait_for(lambda: len(self) == 0, timeout_s)

    def _oldest(self, receiver: str) -> tuple[int, str] | None:
        row: tuple[int, str] | None = self._database.execute(
            "select number, message from waiting where receiver = ? order by number limit 1",
            (receiver,),
        ).fetchone()
        return row


def deliver(
    outbox: Outbox, receiver: str, send: Callable[[Message], None], stopping: threading.Event
) -> None:
    """Send a receiver's messages one after the other, each until it is taken.

    Parameters
    ----------
    outbox : Outbox
    receiver : str
        Its name in the outbox.
    send : callable
        Returns once the receiver has the message; raises DeliveryError or RefusalError.
    stopping : Event
        Ends this.
    """
    failures = 0
    while not stopping.is_set():
        waiting = outbox.wait_for_next(receiver, timeout_s=0.5)
        if waiting is None:
            continue
        number, message = waiting
        try:
            send(message)
        except DeliveryError as error:
            wait_s = RETRY_AFTER_S[min(failures, len(RETRY_AFTER_S) - 1)]
            if not failures:
                say(f"{receiver}: {error}; events wait until it takes them")
            failures += 1
            stopping.wait(wait_s)
            continue
        except RefusalError as error:
            say(f"{receiver} refuses an event, which is dropped: {error}")
        if failures:
            say(f"{receiver} takes events again")
        failures = 0
        outbox.remove(number)
