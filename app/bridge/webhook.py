"""Events as JSON to a URL."""

import json
from urllib.parse import SplitResult

from app.bridge.common import Connection, RefusedError, UnavailableError
from app.bridge.outbox import Message

_TIMEOUT_S = 10.0
_MAX_BYTES = 2**16
_REFUSED = (400, 405, 410, 413, 415, 422)
"""Statuses after which the same event would be refused again."""


class Webhook:
    """Posts each event; the header ``Idempotency-Key`` has its id."""

    def __init__(self, address: SplitResult) -> None:
        self._connection = Connection(address, _TIMEOUT_S, _MAX_BYTES)
        self._target = (address.path or "/") + (f"?{address.query}" if address.query else "")

    def send(self, message: Message) -> None:
        """Post a message; return once it is accepted."""
        headers = {"Content-Type": "application/json", "Idempotency-Key": message["id"]}
        try:
            self._connection.request("POST", self._target, json.dumps(message).encode(), headers)
        except RefusedError as refusal:
            if refusal.status in _REFUSED:
                raise
            raise UnavailableError(str(refusal)) from refusal
        finally:
            # The server would end it before the next event.
            self._connection.close()
