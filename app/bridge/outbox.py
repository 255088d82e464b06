"""Events that wait until each receiver has taken them, in memory and in a file."""

import contextlib
import json
import sqlite3
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from app.bridge import RefusedError, Trouble, UnavailableError, say

Message = Mapping[str, Any]

MAX_WAITING = 100_000  # For a receiver; beyond it, the oldest are dropped.
_POLL_S = 0.2
_WRITING = threading.Lock()  # Cameras share a file; they would wait for each other in SQLite, too.
_WAITS = "queue: {}: events wait in memory"
# A message names its camera, and its id is that of no other camera.
_SCHEMA = """
create table if not exists waiting (
    number integer primary key, receiver text, id text, message text, unique (receiver, id));
create table if not exists newest (camera text primary key, id text);
"""


class Outbox:
    """A camera's messages in order, for several receivers; safe under several threads.

    The path keeps them beyond the end of the process, and those of other cameras; while it cannot
    be written, messages wait in memory alone. ``newest`` is the id of the newest message that was
    put, even by an earlier process; None if none ever was.
    """

    def __init__(self, camera_id: str, receivers: Iterable[str], path: Path | None = None) -> None:
        self.newest: str | None = None
        self._camera_id, self._path = camera_id, path
        self._waiting: dict[str, dict[str, Message]] = {name: {} for name in receivers}
        # Receiver and id of what the file does not have yet, or has although it was taken.
        self._unsaved: dict[tuple[str, str], None] = {}
        self._trouble = Trouble(f"queue: events are stored in {path} again")
        self._changed = threading.Condition()
        if path is not None:
            known_cameras(path)
            self._database = sqlite3.connect(path, check_same_thread=False)
            try:
                self._load()
            except sqlite3.OperationalError as error:  # A full disk, say.
                self._trouble.report(_WAITS.format(error))

    def __len__(self) -> int:
        with self._changed:
            return sum(map(len, self._waiting.values()))

    def put(self, message: Message) -> None:
        """Add a message for each receiver, unless it waits already."""
        with self._changed:
            for receiver, waiting in self._waiting.items():
                if message["id"] not in waiting:
                    waiting[message["id"]] = message
                    self._unsaved[receiver, message["id"]] = None
                if len(waiting) > MAX_WAITING:
                    self._drop(receiver, next(iter(waiting)))
                    say(f"{receiver} has not answered for too long: the oldest event is dropped")
            self.begin_after(message["id"])
            self._changed.notify_all()

    def begin_after(self, message_id: str) -> None:
        """Take a message as the newest that was put; with an empty id, any is newer."""
        with self._changed:
            self.newest = message_id
            self.save()

    def wait_for_next(self, receiver: str, timeout_s: float) -> Message | None:
        """Return a receiver's oldest message; None if there is none."""
        with self._changed:
            waiting = self._waiting[receiver]
            self._changed.wait_for(lambda: waiting, timeout_s)
            return next(iter(waiting.values()), None)

    def remove(self, receiver: str, message_id: str) -> None:
        """Remove a message that its receiver has taken, if it is still there."""
        with self._changed:
            if message_id in self._waiting[receiver]:
                self._drop(receiver, message_id)
                self.save()

    def _drop(self, receiver: str, message_id: str) -> None:
        del self._waiting[receiver][message_id]
        if (receiver, message_id) in self._unsaved:
            del self._unsaved[receiver, message_id]
        else:
            self._unsaved[receiver, message_id] = None

    def _load(self) -> None:
        camera = (self._camera_id,)
        self._database.executescript(_SCHEMA)
        with self._database as database:
            database.execute("insert or ignore into newest values (?, null)", camera)
        rows = self._database.execute("select receiver, id, message from waiting order by number")
        for receiver, message_id, text in rows:
            message = json.loads(text)
            if message["camera_id"] == self._camera_id and receiver in self._waiting:
                self._waiting[receiver][message_id] = message
        row = self._database.execute("select id from newest where camera = ?", camera).fetchone()
        self.newest = row and row[0]

    def save(self) -> bool:
        """Write what the file lacks, all or nothing; return whether it has all that waits."""
        if self._path is None:
            return False
        with self._changed:
            waiting = {key: self._waiting[key[0]].get(key[1]) for key in self._unsaved}
            taken = [key for key, message in waiting.items() if message is None]
            put = [(*key, json.dumps(one)) for key, one in waiting.items() if one is not None]
            newest = (self._camera_id, self.newest)
            try:
                with _WRITING, self._database as database:
                    database.executescript(_SCHEMA)  # The disk may have been full at the start.
                    database.executemany("delete from waiting where receiver = ? and id = ?", taken)
                    database.executemany(
                        "insert or ignore into waiting values (null, ?, ?, ?)", put
                    )
                    database.execute("insert or replace into newest values (?, ?)", newest)
            except sqlite3.Error as error:
                self._trouble.report(_WAITS.format(error))
                return False
            self._unsaved.clear()
            self._trouble.end()
            return True


def known_cameras(path: Path) -> set[str]:
    """Return the cameras whose outboxes a file has; raises OSError if it cannot hold events."""
    try:
        with contextlib.closing(sqlite3.connect(path)) as database:
            # A new file has no tables yet.
            if not database.execute("select * from sqlite_master where name = 'newest'").fetchall():
                return set()
            return {name for (name,) in database.execute("select camera from newest")}
    except sqlite3.Error as error:
        expected = "queue: expected a file for events"
        raise OSError(f"{expected}, got {path}: {error}") from None


def forget_camera(path: Path, camera_id: str) -> None:
    """Remove what a file has of a camera, unless the disk is full."""
    with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(path)) as database:
        of_it = "delete from waiting where json_extract(message, '$.camera_id') = ?"
        with database:
            database.execute(of_it, (camera_id,))
            database.execute("delete from newest where camera = ?", (camera_id,))


def deliver(
    outbox: Outbox,
    stopping: threading.Event,
    receiver: str,
    send: Callable[[Message], None],
    meanwhile: Callable[[], None] = lambda: None,
) -> None:
    """Send a receiver's messages one after the other, each until it is taken or this is stopped.

    ``send`` returns once the receiver has the message; it raises UnavailableError or RefusedError.
    ``meanwhile`` is called several times a second.
    """
    trouble, retry_at = Trouble(f"{receiver} takes events again"), 0.0
    while not stopping.is_set():
        meanwhile()
        if time.monotonic() < retry_at:
            stopping.wait(min(_POLL_S, retry_at - time.monotonic()))
            continue
        message = outbox.wait_for_next(receiver, _POLL_S)
        if message is None:
            continue
        try:
            send(message)
        except UnavailableError as error:
            wait_s = trouble.report(f"{receiver}: {error}; events wait until it takes them")
            retry_at = time.monotonic() + wait_s
            continue
        except RefusedError as error:
            say(f"{receiver} refuses an event, which is dropped: {error}")
        trouble.end()
        outbox.remove(receiver, message["id"])
