"""Frames of a file or a stream, decoded in another process.

The bridge holds passwords, and a stream may be hostile.
"""

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from select import select
from typing import IO

import numpy as np
from numpy.typing import NDArray

from app.bridge.common import say
from app.video.frames import UnreadableError
from app.video.reader import ROOT, environment

# More than any camera has, and more seconds than any stream lasts.
_MAX_PIXELS, _MAX_SECONDS = 2**26, 2**31 - 2
# The decoder waits less for a stream.
_SILENT_S = 20.0
_PIPE_BYTES = 2**20
_MAX_LINE_BYTES = 300


class Decoder:
    """A process that decodes a file, or a stream by its address, until this is closed.

    At most one frame comes in each interval of the video's time.
    """

    def __init__(self, source: Path | str, interval_s: float = 0.0) -> None:
        limits = ("--max-pixels", _MAX_PIXELS, "--max-seconds", _MAX_SECONDS)
        command = [sys.executable, "-m", "app.video.decoder", *map(str, limits)]
        command += ["--interval", str(interval_s)]
        file: IO[bytes] | int = subprocess.PIPE
        if isinstance(source, Path):
            command.append("0")
            file = source.open("rb")
        self._process = subprocess.Popen(
            command, stdin=file, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0,
            cwd=ROOT, env=environment(), pipesize=_PIPE_BYTES,
            start_new_session=True,  # The interrupt of a terminal is for the bridge alone.
        )  # fmt: skip
        assert self._process.stdout is not None
        self._out = self._process.stdout.fileno()
        if isinstance(source, str) and self._process.stdin is not None:
            with suppress(BrokenPipeError), self._process.stdin as address:
                address.write(source.encode() + b"\n")
        elif not isinstance(file, int):
            file.close()

    def frames(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Yield seconds since the first frame, and BGR pixels ``(H, W, 3)``.

        Raises
        ------
        UnreadableError
            If the source, or the rest of it, cannot be read.
        """
        while (head := _head(self._line())) is not None:
            elapsed_s, height, width = head
            pixels = np.empty((height, width, 3), np.uint8)
            self._fill(pixels.data.cast("B"))
            yield elapsed_s, pixels

    def close(self) -> None:
        """End the process, and say what it complained about."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdout, self._process.stderr):
            assert stream is not None
            with stream:
                said = b"" if stream is self._process.stdout else stream.read(_MAX_LINE_BYTES)
        if said:
            say(f"the source: {said.decode(errors='replace').splitlines()[-1]}")

    def _line(self) -> bytes:
        line, byte = bytearray(), bytearray(1)
        while not line.endswith(b"\n"):
            self._fill(memoryview(byte))
            line += byte
            if len(line) > _MAX_LINE_BYTES:
                raise UnreadableError("one that the decoder does not describe")
        return bytes(line)

    def _fill(self, buffer: memoryview) -> None:
        """Read as many bytes as a buffer has."""
        while buffer:
            if not select([self._out], [], [], _SILENT_S)[0]:
                raise UnreadableError(f"no frame within {_SILENT_S:g} seconds")
            count = os.readv(self._out, [buffer])
            if not count:
                raise UnreadableError("one that the decoder gave up on")
            buffer = buffer[count:]


def _head(line: bytes) -> tuple[float, int, int] | None:
    """Seconds, rows and columns of a frame that a decoder announces; None at the end.

    The decoder is trusted with nothing: a hostile stream may have taken it over.
    """
    try:
        head = json.loads(line)
        end = head.get("end", "")
        sizes = [head.get(name, 0) for name in ("height", "width")]
        height, width = (
            size if type(size) is int and size > 0 else _MAX_PIXELS + 1 for size in sizes
        )
        elapsed_s = float(head.get("timestamp", 0.0))
    except (ValueError, TypeError, AttributeError):
        raise UnreadableError("one that the decoder does not describe") from None
    if end is None:
        return None
    if end:
        raise UnreadableError(str(end))
    if height * width > _MAX_PIXELS or not math.isfinite(elapsed_s):
        raise UnreadableError("a frame that is too large")
    return elapsed_s, height, width
