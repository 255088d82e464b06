"""``python -m app``: serve on ``HOST``:``PORT`` with ``WORKERS`` processes.

A stop by SIGTERM or Ctrl-C finishes the requests that run and ends with status 0.
"""

from __future__ import annotations

import os
import signal

import uvicorn

from app.logs import log_config
from app.settings import Settings

GRACE_S = 15
# Longer than a camera that sends a frame a minute waits between two.
KEEP_ALIVE_S = 65


def main() -> None:
    """Serve until told to stop."""
    # Once it has shut down, uvicorn raises the signal again, for the handler it found here.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    uvicorn.run(
        "app.main:create_app",
        factory=True,
        host=os.environ.get("HOST", "127.0.0.1"),
        port=int(os.environ.get("PORT", "8000")),
        workers=int(os.environ.get("WORKERS", "1")),
        timeout_graceful_shutdown=GRACE_S,
        timeout_keep_alive=KEEP_ALIVE_S,
        server_header=False,
        log_config=log_config(Settings().log_level),
    )


if __name__ == "__main__":
    main()
