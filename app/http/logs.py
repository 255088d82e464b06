"""Logs as JSON, one object per line."""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime
from typing import Any

from app.http.request_state import request_id


class JsonFormatter(logging.Formatter):
    """Formats a log record as one line of JSON, with the id of its request."""

    def format(self, record: logging.LogRecord) -> str:
        """Write one record."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if request_id.get():
            line["request_id"] = request_id.get()
        line |= getattr(record, "fields", {})
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def log_config(level: str) -> dict[str, Any]:
    """Return a configuration for :func:`logging.config.dictConfig`: all to standard output."""
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"json": {"()": "app.http.logs.JsonFormatter"}},
        "handlers": {
            "out": {
                "class": "logging.StreamHandler",
                "formatter": "json",
                "stream": "ext://sys.stdout",
            }
        },
        "root": {"handlers": ["out"], "level": "WARNING"},
        "loggers": {
            "app": {"level": level.upper()},
            "uvicorn": {"level": level.upper()},
            # The logger app.request replaces uvicorn's access log.
            "uvicorn.access": {"level": "WARNING"},
            # A broken form from a client gets a 400 and needs no log line.
            "python_multipart": {"level": "ERROR"},
        },
    }
