"""A camera session of a service, over HTTP."""

from __future__ import annotations

import http.client
import json
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import cv2

from scripts.watch_camera.common import connection_to
from scripts.watch_camera.source import Frame

RETRY_AFTER_S = 1.0
_TIMEOUT_S = 20.0


class RefusedError(Exception):
    """The service refuses a frame; the message says why."""

    def __init__(self, status: int, detail: str, retry_after_s: float) -> None:
        super().__init__(detail)
        self.status, self.retry_after_s = status, retry_after_s


class Camera:
    """A camera session of a service."""

    def __init__(self, url: str, camera_id: str, api_key: str | None) -> None:
        parts = urlsplit(url)
        self.camera_id = camera_id
        self._connection = connection_to(parts, _TIMEOUT_S)
        self._path = f"{parts.path.rstrip('/')}/cameras/{quote(camera_id, safe='')}"
        self._headers = {"X-API-Key": api_key} if api_key else {}

    def track(self, frame: Frame) -> tuple[bool, dict[str, Any]]:
        """Return whether the session is new, and the service's answer."""
        encoded = cv2.imencode(".jpg", frame.pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
        query = urlencode({"timestamp": f"{frame.timestamp:.4f}", "n": 1, "joints": "none"})
        headers, body = self._send("POST", f"{self._path}/frames?{query}", encoded)
        return headers["X-Session"] == "new", json.loads(body)

    def zones(self) -> list[str]:
        """Return the names of the camera's zones; it has sent a frame."""
        return [zone["name"] for zone in json.loads(self._send("GET", self._path)[1])["zones"]]

    def events(self) -> list[dict[str, Any]]:
        """Return the latest events of the camera."""
        events: list[dict[str, Any]] = json.loads(self._send("GET", f"{self._path}/events")[1])[
            "events"
        ]
        return events

    def _send(
        self, method: str, path: str, body: bytes | None = None
    ) -> tuple[http.client.HTTPMessage, bytes]:
        headers = self._headers | ({"Content-Type": "image/jpeg"} if body else {})
        try:
            self._connection.request(method, path, body, headers)
            response = self._connection.getresponse()
            content = response.read()
        except BaseException:
            self._connection.close()  # The next request opens another one.
            raise
        if response.status < 300:
            return response.headers, content
        try:
            detail = json.loads(content)["detail"]
        except (ValueError, KeyError, TypeError):
            detail = response.reason
        after = response.headers.get("Retry-After", "")
        raise RefusedError(
            response.status, str(detail), float(after) if after.isdecimal() else RETRY_AFTER_S
        )
