"""Events as JSON to a URL."""

from __future__ import annotations

import http.client
import json
from urllib.parse import urlsplit

from scripts.watch_camera.common import connection_to
from scripts.watch_camera.outbox import DeliveryError, Message, RefusalError

_TIMEOUT_S = 10.0
_REFUSED = (400, 405, 410, 413, 415, 422)
"""Statuses after which the same event would be refused again."""


class Webhook:
    """Posts each event; the header ``Idempotency-Key`` has its id."""

    def __init__(self, url: str) -> None:
        self._parts = urlsplit(url)

    def send(self, message: Message) -> None:
        """Post a message; return once it is accepted."""
        parts = self._parts
        connection = connection_to(parts, _TIMEOUT_S)
        headers = {"Content-Type": "application/json", "Idempotency-Key": message["id"]}
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        try:
            connection.request("POST", target, json.dumps(message), headers)
            status = connection.getresponse().status
        except (OSError, http.client.HTTPException) as error:
            raise DeliveryError(f"no answer ({error})") from error
        finally:
            connection.close()
        if status in _REFUSED:
            raise RefusalError(f"status {status}")
        if not 200 <= status < 300:
            raise DeliveryError(f"status {status}")
