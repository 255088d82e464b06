"""What the bridge says to its operator; standard output is for events alone."""

from __future__ import annotations

import sys
import time


def say(text: str) -> None:
    """Print a line with the time of day to standard error."""
    print(time.strftime("%H:%M:%S"), text, file=sys.stderr, flush=True)
