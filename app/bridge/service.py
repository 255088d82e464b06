"""A camera session of a service, over HTTP."""

import json
from typing import Any
from urllib.parse import SplitResult, urlencode

import cv2

from app.bridge.common import Connection, RefusedError, UnavailableError
from app.bridge.source import Frame

_TIMEOUT_S = 20.0
_MAX_BYTES = 16 * 2**20


class Camera:
    """A camera session of a service; raises what :class:`Connection` does."""

    def __init__(self, address: SplitResult, camera_id: str, api_key: str | None) -> None:
        self.camera_id = camera_id
        self._connection = Connection(address, _TIMEOUT_S, _MAX_BYTES)
        self._path = f"{address.path.rstrip('/')}/cameras/{camera_id}"
        self._headers = {"X-API-Key": api_key} if api_key else {}

    def track(self, frame: Frame) -> tuple[bool, dict[str, Any]]:
        """Return whether the session is new, and the service's answer."""
        encoded = cv2.imencode(".jpg", frame.pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
        query = urlencode({"timestamp": f"{frame.timestamp:.4f}", "n": 1, "joints": "none"})
        return self._send("POST", f"/frames?{query}", "persons", encoded)

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

    def _send(
        self, method: str, path: str, expected: str, body: bytes | None = None
    ) -> tuple[bool, dict[str, Any]]:
        """Return whether the session is new, and an answer that has an expected field."""
        headers = self._headers | ({"Content-Type": "image/jpeg"} if body else {})
        answer, content = self._connection.request(method, self._path + path, body, headers)
        try:
            parsed = json.loads(content)
            parsed[expected]
        except (ValueError, KeyError, TypeError, RecursionError):
            raise UnavailableError(f"expected JSON with {expected}, got something else") from None
        return answer["X-Session"] == "new", parsed
