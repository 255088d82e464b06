"""What the bridge sends over HTTP: frames to a service, events to a webhook."""

import base64
import contextlib
import http.client
import json
import socket
import threading
from collections.abc import Mapping
from typing import Any
from urllib.parse import SplitResult, unquote, urlencode

import cv2

from app.bridge import RETRY_AFTER_S, RefusedError, UnavailableError
from app.bridge.outbox import Message
from app.decoding import Frame

_FRAME_TIMEOUT_S, _EVENT_TIMEOUT_S = 20.0, 10.0
_MAX_REPLY_BYTES = 16 * 2**20


class Connection:
    """Requests to the host of an address, one after the other over one connection.

    Credentials in the address are sent with each request (basic authentication), so redirects are
    not followed. An answer may take ``timeout_s``; of a longer one, ``max_bytes`` are read.
    """

    def __init__(self, address: SplitResult, timeout_s: float, max_bytes: int) -> None:
        self._timeout_s, self._max_bytes = timeout_s, max_bytes
        secure = address.scheme == "https"
        connect = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        port = address.port or (443 if secure else 80)
        self._connection = connect(address.hostname or "", port, timeout=timeout_s)
        self._headers = {}
        if address.username is not None:
            pair = f"{unquote(address.username)}:{unquote(address.password or '')}"
            encoded = base64.b64encode(pair.encode()).decode()
            self._headers["Authorization"] = f"Basic {encoded}"

    def request(
        self, method: str, target: str, body: bytes | None, headers: dict[str, str]
    ) -> tuple[http.client.HTTPMessage, bytes]:
        """Return headers and content of an answer.

        Raises ``UnavailableError`` if there is none, ``RefusedError`` for a status of 300 or more.
        """
        connection, is_late = self._connection, threading.Event()
        timer = threading.Timer(self._timeout_s, self._abort, [is_late])
        timer.start()
        try:
            connection.request(method, target, body, self._headers | headers)
            response = connection.getresponse()
            content = response.read(self._max_bytes)
            if not response.isclosed():
                self.close()  # The rest is not read.
            if is_late.is_set():
                raise TimeoutError
        except (OSError, http.client.HTTPException) as error:
            self.close()
            reason = str(error) or type(error).__name__
            reason = "the answer took too long" if is_late.is_set() else reason
            raise UnavailableError(reason) from error
        finally:
            timer.cancel()
        if response.status < 300:
            return response.headers, content
        try:
            if response.status < 400:
                place = response.headers.get("Location", "nowhere")
                detail = f"expected an answer, got a redirect, which is not followed, to {place}"
            else:
                detail = str(json.loads(content)["detail"])
        except (ValueError, KeyError, TypeError, RecursionError):
            detail = response.reason
        after = response.headers.get("Retry-After", "")
        wait_s = RETRY_AFTER_S if response.status > 500 else 0.0
        raise RefusedError(
            f"{detail} ({response.status})",
            response.status,
            float(after) if after.isdecimal() else wait_s,
        )

    def _abort(self, is_late: threading.Event) -> None:
        """End a connection on which an answer trickles, so that who reads it goes on."""
        is_late.set()
        with contextlib.suppress(OSError, AttributeError):
            socket.socket.shutdown(self._connection.sock, socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection; the next request opens another one."""
        self._connection.close()


class Camera:
    """A camera session of a service; raises what :class:`Connection` does."""

    def __init__(
        self,
        address: SplitResult,
        camera_id: str,
        api_key: str | None,
        configuration: Mapping[str, Any] | None = None,
    ) -> None:
        self.camera_id, self._configuration = camera_id, configuration
        self._connection = Connection(address, _FRAME_TIMEOUT_S, _MAX_REPLY_BYTES)
        self._origin = f"{address.scheme}://{address.netloc.rpartition('@')[2]}"
        self._path = f"{address.path.rstrip('/')}/cameras/{camera_id}"
        self._headers = {"X-API-Key": api_key} if api_key else {}

    def track(self, frame: Frame) -> tuple[bool, dict[str, Any]]:
        """Return whether the session is new, and the service's answer."""
        encoded = cv2.imencode(".jpg", frame.pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
        query = urlencode({"timestamp": f"{frame.timestamp:.4f}", "n": 1, "joints": "none"})
        return self._send("POST", f"/frames?{query}", "persons", encoded)

    def configure(self) -> None:
        """Set zones, optics and events, unless they are left to the service."""
        if self._configuration is not None:
            body = json.dumps(self._configuration).encode()
            self._send("PUT", "", "zones", body)

    def settings(self) -> tuple[list[str], list[str]]:
        """Return the names of the camera's zones, and the events it raises; it has sent a frame."""
        camera = self._send("GET", "", "zones")[1]
        return [zone["name"] for zone in camera["zones"]], camera["events"]

    def events(self) -> list[dict[str, Any]]:
        """Return the latest events of the camera, oldest first; none if it is not known."""
        try:
            events: list[dict[str, Any]] = self._send("GET", "/events", "events")[1]["events"]
        except RefusedError as refusal:
            if refusal.status != 404:
                raise
            return []
        return events

    def replay_url(self, event_id: str) -> str:
        """Where others find the replay of an event; without the password of the service."""
        return f"{self._origin}{self._path}/events/{event_id}/replay"

    def replay(self, event_id: str) -> bytes:
        """Return what was seen of an event so far, as an animated WebP."""
        path = f"{self._path}/events/{event_id}/replay"
        return self._connection.request("GET", path, None, self._headers)[1]

    def _send(
        self, method: str, path: str, expected: str, body: bytes | None = None
    ) -> tuple[bool, dict[str, Any]]:
        """Return whether the session is new, and an answer that has an expected field."""
        kind = "image/jpeg" if method == "POST" else "application/json"
        headers = self._headers | ({"Content-Type": kind} if body else {})
        answer, content = self._connection.request(method, self._path + path, body, headers)
        try:
            parsed = json.loads(content)
            parsed[expected]
        except (ValueError, KeyError, TypeError, RecursionError):
            raise UnavailableError(f"expected JSON with {expected}, got something else") from None
        return answer["X-Session"] == "new", parsed


class Webhook:
    """Posts each event; the header ``Idempotency-Key`` has its id."""

    def __init__(self, address: SplitResult) -> None:
        self._connection = Connection(address, _EVENT_TIMEOUT_S, 2**16)
        self._target = (address.path or "/") + (f"?{address.query}" if address.query else "")

    def send(self, message: Message) -> None:
        """Post a message; return once it is accepted."""
        headers = {"Content-Type": "application/json", "Idempotency-Key": message["id"]}
        try:
            self._connection.request("POST", self._target, json.dumps(message).encode(), headers)
        except RefusedError as refusal:
            # The same event would be refused again.
            if refusal.status in (400, 405, 410, 413, 415, 422):
                raise
            raise UnavailableError(str(refusal)) from refusal
        finally:
            # The server would end it before the next event.
            self._connection.close()
