"""A service and a webhook that answer as they are told, and a disk without room."""

import json
import resource
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from app.configuration import EVENT_NAMES
from tests.golden.answers import FOLDER
from tests.support.ports import free_ports


class Webhook:
    """Answers by ``statuses``, then with 204; collects what it has taken."""

    def __init__(self) -> None:
        self.statuses: list[int] = []
        self.got: list[dict[str, Any]] = []
        self.seen: list[tuple[str, str]] = []
        self.headers: list[dict[str, str]] = []

    def answer(self, method: str, path: str, body: bytes) -> tuple[int, Any]:
        """Return the status, 0 for a connection that ends, and the content of an answer."""
        status = self.statuses.pop(0) if self.statuses else 204
        if status == 204:
            self.got.append(json.loads(body))
        return status, None


class Service(Webhook):
    """Answers frames by ``statuses``, then with 200; each has the next of ``events``.

    It lists the events of all frames that it has processed, also of those with the status 0.
    """

    def __init__(self, *events: str) -> None:
        super().__init__()
        self.events = [event(name, 1e9 + number) for number, name in enumerate(events)]
        self.listed: list[dict[str, Any]] = []
        self.raised = list(EVENT_NAMES)
        self.sessions: list[str] = []
        """``X-Session`` of the next frames; then ``warm``."""

    def answer(self, method: str, path: str, body: bytes) -> tuple[int, Any]:
        if path.endswith("/events"):
            return (200, {"events": self.listed}) if self.listed else (404, {"detail": "unknown"})
        if method == "GET":
            return 200, {"zones": [], "events": self.raised}
        status = self.statuses.pop(0) if self.statuses else 200
        if status > 200:
            return status, {"detail": f"status {status}"}
        events = [self.events.pop(0)] if self.events else []
        self.listed += events
        answer = {
            "image": {"warnings": []},
            "persons": [
                {"track_id": one["track_id"], "zones": [], "posture": None}
                for one in self.listed[-1:]
                if one["event"] == "entered"
            ],
            "events": events,
            "reset": None,
            "timestamp": 1e9,
            "timings_ms": {"total": 9.0},
        }
        return status, answer


REPORTED = {
    one["event"]: one
    for film in ("falls", "crossing")
    for one in json.loads((FOLDER / f"{film}-events.json").read_text())["body"]["events"]
}
"""Events by name, as the service reported them of the golden films."""


def event(name: str, timestamp: float) -> dict[str, Any]:
    """An event as the service reports it, at a time; all have the fields of ``entered``."""
    known = {"id": f"{name}-{timestamp}", "timestamp": timestamp}
    return {**REPORTED["entered"], **REPORTED.get(name, {"event": name}), **known}


@contextmanager
def serving(fake: Webhook, port: int = 0) -> Iterator[str]:
    """Serve a fake; yields its host and port."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            status, content = fake.answer(self.command, self.path, body)
            fake.seen.append((f"{self.command} {status}", self.path))
            fake.headers.append(dict(self.headers))
            if status == 0:
                self.close_connection = True
                return
            answer = b"" if content is None else json.dumps(content).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(answer)))
            sessions = getattr(fake, "sessions", None) if self.command == "POST" else None
            self.send_header("X-Session", sessions.pop(0) if sessions else "warm")
            self.send_header("Retry-After", "0")
            self.end_headers()
            self.wfile.write(answer)

        do_GET = do_PUT = do_POST  # noqa: N815

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", port or free_ports(1)[0]), Handler) as server:
        # By default, it would notice its end after half a second.
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()


@contextmanager
def full_disk() -> Iterator[None]:
    """No file grows."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
